"""The dish: a rigid spherical cap, concave face to the sonar, and what it returns.

From the front its echo is the sum of glints (``glints``) of tabled strength (``dish_table``) and
of the rim's own diffraction (``rim``); from behind it is a plain convex cap. The two-bounce ring
carries most of the energy and, by its delay, the size.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ertis_simulator.circles import RIM, RING_2, VERTEX
from ertis_simulator.dish_table import between_tilts, scaled_log, strengths
from ertis_simulator.echoes import Echoes
from ertis_simulator.glint_kernels import bessel_table, sum_glints, tabled_strengths
from ertis_simulator.glints import FOCUSED, ORDERS, TERMS, Glints, glints
from ertis_simulator.rim import rim_orders

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

RADII_MM = (35, 48, 58, 70)
DEPTH_RATIO = 0.6  # depth over aperture radius: 30 % of the diameter
# Of a sharp edge's diffraction: 1 for a rim of no thickness, less for one that is tapered softly.
RIM_STRENGTH = 1.0
_SPREAD_M = 0.06  # over frequency, strengths vary: an echo lasts longer than its circle is long
_EDGE_SOFTNESS_RAD = np.deg2rad(3.0)  # the specular point fades over about a Fresnel zone
_RIM_TERMS = [TERMS.index((RIM, order)) for order in ORDERS[RIM]]
_CIRCLE_OF_TERM = np.array([circle for circle, _ in TERMS])
_ORDER_OF_TERM = np.array([order for _, order in TERMS])
_TURN_OF_TERM = np.where(_CIRCLE_OF_TERM == RIM, (-1j) ** _ORDER_OF_TERM, 1.0)[:, None]
_VERTEX_TERM = TERMS.index((VERTEX, 0))


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


@dataclass(frozen=True, eq=False)
class DishEcho:
    """One dish as many microphones hear it by one way; an ``ertis_simulator.echoes.Scatterer``."""

    dish: Dish
    laid: Glints
    rim_strength: float = RIM_STRENGTH

    @cached_property
    def path_m(self) -> FloatArray:
        """Way by the two-bounce ring, or by the convex back's vertex, shape (num_mics,)."""
        loudest = np.where(self._behind, self.laid.path_m[VERTEX], self.laid.path_m[RING_2])
        return np.asarray(self.laid.centre_path_m + loudest)

    @property
    def reach_m(self) -> tuple[float, float]:
        """From the nearest point of its circles to the farthest, and what strengths spread."""
        way = self.laid.centre_path_m + self.laid.path_m
        size = np.where(np.arange(len(way))[:, None] == RIM, np.abs(self.laid.reach_m), 0.0)
        before = np.max(self.path_m - (way - size).min(axis=0))
        behind = np.max((way + size).max(axis=0) - self.path_m)
        return float(before) + _SPREAD_M, float(behind) + _SPREAD_M

    @cached_property
    def _behind(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self.laid.tilt_rad > np.pi / 2)

    @cached_property
    def _steady(self) -> npt.NDArray[np.complex64]:
        """Strengths beside the table's: sharp rim, no back. Shape (num_mics, num_terms)."""
        tilt, alpha = self.laid.tilt_rad, self.dish.half_opening_rad
        steady = np.zeros((len(tilt), len(TERMS)), np.complex64)
        share = self.rim_strength - np.where(self._behind, 0.0, 1.0)
        if share.any():
            steady[:, _RIM_TERMS] += share[:, None] * rim_orders(alpha, tilt)
        if self._behind.any():
            half_radius = self.dish.sphere_radius_m / self.dish.aperture_radius_m / 2
            facing = 1 / (1 + np.exp((np.pi - tilt - alpha) / _EDGE_SOFTNESS_RAD))
            steady[:, _VERTEX_TERM] += np.where(self._behind, half_radius * facing, 0)
        return steady

    @cached_property
    def _weights(self) -> npt.NDArray[np.complex64]:
        """What a term has at any frequency: spreading and turn, shape (num_terms, num_mics)."""
        cosines = np.cos(_ORDER_OF_TERM[:, None] * self.laid.around_rad[_CIRCLE_OF_TERM])
        spreading = self.laid.spreading[_CIRCLE_OF_TERM] * self.dish.aperture_radius_m
        return np.asarray((_TURN_OF_TERM * cosines * spreading).astype(np.complex64))

    def spectrum(self, k_rad_m: FloatArray, from_m: FloatArray | None = None) -> ComplexArray:
        """As the renderer asks for, shape (num_mics, num_k)."""
        laid, ka = self.laid, k_rad_m * self.dish.aperture_radius_m
        ratio = round(self.dish.depth_m / self.dish.aperture_radius_m, 6)
        rows, share, coefficients = between_tilts(strengths(ratio), laid.tilt_rad)
        scaled = scaled_log(ka, strengths(ratio).highest_ka).astype(np.float32)
        total = np.empty((len(laid.tilt_rad), len(k_rad_m)), np.complex64)
        sum_glints(
            total,
            k_rad_m,
            np.where(FOCUSED[:, None], np.sqrt(ka), 1.0).astype(np.float32),
            laid.path_m + (laid.centre_path_m - (self.path_m if from_m is None else from_m)),
            laid.reach_m,
            tabled_strengths(coefficients, scaled),
            np.where(self._behind, -1, rows),
            share,
            self._steady,
            self._weights,
            _CIRCLE_OF_TERM,
            _ORDER_OF_TERM,
            bessel_table(),
        )
        return total


def dish_echoes(
    dish: Dish,
    axis: FloatArray,
    vertex_m: FloatArray,
    emitter_m: FloatArray,
    mics_m: FloatArray,
    *,
    rim_strength: float = RIM_STRENGTH,
) -> Echoes:
    """What a dish returns to many microphones from one emitter.

    Parameters
    ----------
    dish : Dish
    axis : shape (3,)
        Unit vector out of the opening.
    vertex_m : shape (3,)
        Deepest point of the concave face.
    emitter_m, mics_m : shape (3,) and (num_mics, 3)
        May be mirror images, for echoes by way of the floor.
    rim_strength : float
        Of the rim's diffraction: 1 for a sharp edge.

    Returns
    -------
    Echoes
        No points, one body.
    """
    centre_m = vertex_m + dish.sphere_radius_m * axis
    laid = glints(
        dish.aperture_radius_m, dish.depth_m, axis, emitter_m - centre_m, mics_m - centre_m
    )
    return Echoes.from_body(DishEcho(dish, laid, rim_strength))
