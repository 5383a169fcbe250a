"""Screens of revolution as curves that start on the axis, and their cutting into panels.

Lengths are in any one unit (the aperture radius, for the landmark). z points out of the
concave side, the sphere's centre is the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ertis_simulator.landmark import DEPTH_RATIO, Dish

FloatArray = npt.NDArray[np.float64]

RIM_PANEL = 0.4  # of a panel: there the pressure is a polynomial in sqrt(distance to the rim)


@dataclass(frozen=True, slots=True)
class Curve:
    """Points of a meridian: distance from the axis, height, and the unit tangent's parts."""

    rho: FloatArray
    z: FloatArray
    rho_s: FloatArray
    z_s: FloatArray


class Meridian(Protocol):
    """A curve from the axis to the rim, by arc length."""

    @property
    def length(self) -> float:
        """Arc length from the axis to the rim."""

    @property
    def max_rho(self) -> float:
        """Largest distance from the axis."""

    def at(self, arc: FloatArray) -> Curve:
        """Points at these arc lengths."""


@dataclass(frozen=True, slots=True)
class CapMeridian:
    """Part of a sphere around its lowest point, half opening angle ``half_opening_rad``."""

    sphere_radius: float
    half_opening_rad: float

    @classmethod
    def landmark(cls) -> CapMeridian:
        """The landmark's dish, aperture radius 1."""
        dish = Dish(1.0, DEPTH_RATIO)
        return cls(dish.sphere_radius_m, dish.half_opening_rad)

    @property
    def length(self) -> float:
        """Arc length from the axis to the rim."""
        return self.sphere_radius * self.half_opening_rad

    @property
    def max_rho(self) -> float:
        """Largest distance from the axis."""
        return self.sphere_radius * float(np.sin(min(self.half_opening_rad, np.pi / 2)))

    def at(self, arc: FloatArray) -> Curve:
        """Points at these arc lengths."""
        angle = arc / self.sphere_radius
        sine, cosine = np.sin(angle), np.cos(angle)
        return Curve(self.sphere_radius * sine, -self.sphere_radius * cosine, cosine, sine)


@dataclass(frozen=True, slots=True)
class DiscMeridian:
    """A flat disc in the plane z = 0."""

    radius: float = 1.0

    @property
    def length(self) -> float:
        """Radius."""
        return self.radius

    @property
    def max_rho(self) -> float:
        """Radius."""
        return self.radius

    def at(self, arc: FloatArray) -> Curve:
        """Points at these arc lengths."""
        return Curve(arc, np.zeros_like(arc), np.ones_like(arc), np.zeros_like(arc))


@dataclass(frozen=True, slots=True)
class Panels:
    """A meridian cut into panels, each with its own coordinate ``u`` in [0, 1].

    The last one ends at the rim with ``s = end - length (1 - u)^2``, so that polynomials in u
    hold the square root by which the pressure jump vanishes there.
    """

    meridian: Meridian
    starts: FloatArray
    lengths: FloatArray

    @classmethod
    def cut(cls, meridian: Meridian, wavenumber: float, per_wavelength: float) -> Panels:
        """At least three panels, at least ``per_wavelength`` of them a wavelength."""
        wavelengths = wavenumber * meridian.length / (2 * np.pi)
        whole = max(2, int(np.ceil(wavelengths * per_wavelength - RIM_PANEL)))
        relative = np.append(np.ones(whole), RIM_PANEL)
        lengths = relative * meridian.length / relative.sum()
        return cls(meridian, np.append(0.0, np.cumsum(lengths)[:-1]), lengths)

    def __len__(self) -> int:
        return len(self.starts)

    def at(self, panel: npt.NDArray[np.int64], u: FloatArray) -> tuple[Curve, FloatArray]:
        """Points of panels, and ds/du there; ``panel`` and ``u`` broadcast."""
        is_rim = panel == len(self) - 1
        share = np.where(is_rim, 1 - (1 - u) ** 2, u)
        slope = np.where(is_rim, 2 * (1 - u), 1.0)
        arc = self.starts[panel] + self.lengths[panel] * share
        return self.meridian.at(arc), self.lengths[panel] * slope
