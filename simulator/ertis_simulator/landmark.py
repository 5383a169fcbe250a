"""The dish: a rigid spherical cap, concave face to the sonar, and the echoes it returns.

Closed form of its glints: rim, vertex, and the rings of two and three bounces. The rings
carry most of the energy and, by their delays, the size. Lengths in m; an n-bounce ring has
incidence i = (pi/2)(1 - 1/n), radius b = R sin i and path 2 n R cos i from the sphere's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes

FloatArray = npt.NDArray[np.float64]

RADII_MM = (35, 48, 58, 70)
DEPTH_RATIO = 0.6  # depth over aperture radius: 30 % of the diameter
# Assumed: what a rim tapered to 0.4 mm leaves of a sharp rim's echo.
RIM_STRENGTH = 0.25
RING_POINTS, RIM_POINTS = 12, 40
_EDGE_SOFTNESS_RAD = np.deg2rad(3.0)  # the specular point fades over about a Fresnel zone


@dataclass(frozen=True, slots=True)
class Dish:
    """A spherical cap.

    aperture_radius_m, depth_m : float
        Of the opening; how deep it is.
    """

    aperture_radius_m: float
    depth_m: float

    @classmethod
    def landmark(cls, radius_mm: float) -> Dish:
        """The printed landmark of that aperture radius."""
        return cls(radius_mm / 1000, DEPTH_RATIO * radius_mm / 1000)

    @property
    def sphere_radius_m(self) -> float:
        """R = (a^2 + d^2) / (2 d)."""
        return (self.aperture_radius_m**2 + self.depth_m**2) / (2 * self.depth_m)

    @property
    def half_opening_rad(self) -> float:
        """Angle between axis and rim, seen from the sphere's centre."""
        return float(np.arccos(1 - self.depth_m / self.sphere_radius_m))


def lit_fraction(tilt_rad: FloatArray, incidence_rad: float, half_opening_rad: float) -> FloatArray:
    """Part of a ring that a tilted dish still returns: 1 frontal, 0 past the limiting angle."""
    with np.errstate(divide="ignore"):
        argument = (np.cos(tilt_rad) * np.cos(incidence_rad) - np.cos(half_opening_rad)) / (
            np.sin(tilt_rad) * np.sin(incidence_rad)
        )
    return np.asarray(np.maximum(2 / np.pi * np.arcsin(np.clip(argument, -1, 1)), 0))


def dish_echoes(
    dish: Dish,
    axis: FloatArray,
    vertex_m: FloatArray,
    emitter_m: FloatArray,
    mics_m: FloatArray,
) -> Echoes:
    """What a dish returns to many microphones from one emitter.

    Rings and rim are sampled at points around them: their sum is the Bessel function by which
    a ring loses its focus between emitter and microphone, or off axis.

    Parameters
    ----------
    dish : Dish
    axis : shape (3,)
        Unit vector out of the opening.
    vertex_m : shape (3,)
        Deepest point of the concave face.
    emitter_m, mics_m : shape (3,) and (num_mics, 3)
        May be mirror images, for echoes by way of the floor.

    Returns
    -------
    Echoes
        Rim, vertex, two-bounce ring, three-bounce ring; dark ones have gain 0.
    """
    radius, alpha, aperture = dish.sphere_radius_m, dish.half_opening_rad, dish.aperture_radius_m
    centre_m = vertex_m + radius * axis
    to_emitter, to_mics = emitter_m - centre_m, mics_m - centre_m
    r_s = float(np.linalg.norm(to_emitter))
    r_m = np.linalg.norm(to_mics, axis=1)
    unit_s, unit_m = to_emitter / r_s, to_mics / r_m[:, None]
    bisector = unit_m + unit_s
    bisector /= np.maximum(np.linalg.norm(bisector, axis=1), 1e-9)[:, None]
    tilt = np.maximum(np.arccos(np.clip(bisector @ axis, -1, 1)), 1e-6)
    facing = np.where(tilt < np.pi / 2, 1.0, 0.0)
    curvature = (1 / r_s + 1 / r_m) / 2
    spreading = 1 / (r_s * r_m)
    travel = r_s + r_m

    seen = 1 / (1 + np.exp((tilt - alpha) / _EDGE_SOFTNESS_RAD))
    parts = [Echoes.of(travel + 2 * radius, -radius / 2 * seen * spreading)]
    for bounces in (2, 3):
        incidence = np.pi / 2 * (1 - 1 / bounces)
        ring, chord = radius * np.sin(incidence), radius * np.cos(incidence)
        strength = ring * np.sqrt(2 * np.pi * chord / (2 * bounces))
        gain = strength * facing * lit_fraction(tilt, incidence, alpha) * spreading
        path = travel + 2 * bounces * chord + ring**2 * curvature
        for offset in _ring_points(axis, ring, RING_POINTS):
            skew = (unit_s - unit_m) @ offset  # in at one point, out at the opposite one
            parts.append(Echoes.of(path + skew, gain / RING_POINTS, exponent=0.5))
    rim = centre_m - (radius - dish.depth_m) * axis
    gain = RIM_STRENGTH * aperture / 2 * facing * np.cos(tilt) * spreading / RIM_POINTS
    for offset in _ring_points(axis, aperture, RIM_POINTS):
        point = rim + offset
        path = np.linalg.norm(emitter_m - point) + np.linalg.norm(mics_m - point, axis=1)
        parts.append(Echoes.of(path, gain))
    return Echoes.join(parts)


def _ring_points(axis: FloatArray, radius_m: float, count: int) -> FloatArray:
    """Points of a circle around ``axis``, shape (count, 3), relative to its centre."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = np.cross(axis, helper)
    across /= np.linalg.norm(across)
    up = np.cross(axis, across)
    angle = 2 * np.pi * (np.arange(count) + 0.25) / count
    return radius_m * (np.outer(np.cos(angle), across) + np.outer(np.sin(angle), up))
