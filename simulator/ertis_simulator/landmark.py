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

from ertis_simulator.dish_table import NUM_POWERS, at_tilts, powers, strengths
from ertis_simulator.echoes import Echoes
from ertis_simulator.glints import FOCUSED, ORDERS, RIM, RING_2, TERMS, VERTEX, Glints, glints
from ertis_simulator.kernels import bessel_table, sum_glints
from ertis_simulator.rim import rim_orders

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

RADII_MM = (35, 48, 58, 70)
DEPTH_RATIO = 0.6  # depth over aperture radius: 30 % of the diameter
# Of a sharp edge's diffraction: 1 for a rim of no thickness, less for one that is tapered softly.
RIM_STRENGTH = 1.0
_EDGE_SOFTNESS_RAD = np.deg2rad(3.0)  # the specular point fades over about a Fresnel zone
_RIM_TERMS = [TERMS.index((RIM, order)) for order in ORDERS[RIM]]
_CIRCLE_OF_TERM = np.array([circle for circle, _ in TERMS])
_ORDER_OF_TERM = np.array([order for _, order in TERMS])
_IS_RIM = _CIRCLE_OF_TERM == RIM


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
        """From the nearest point of the rim to the last ring, wherever ``path_m`` is."""
        aperture, sphere = self.dish.aperture_radius_m, self.dish.sphere_radius_m
        return 2.2 * aperture + 3.2 * sphere, 2.2 * sphere + 2.2 * aperture

    @cached_property
    def _behind(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self.laid.tilt_rad > np.pi / 2)

    @cached_property
    def _coefficients(self) -> npt.NDArray[np.complex64]:
        """Of all terms, shape (num_mics, num_terms, NUM_POWERS)."""
        tilt, alpha = self.laid.tilt_rad, self.dish.half_opening_rad
        found = at_tilts(strengths(self._depth_ratio), tilt)
        found[self._behind] = 0
        # The table has a sharp rim, and no back. The first polynomial is 1: what does not depend
        # on frequency goes there.
        share = self.rim_strength - np.where(self._behind, 0.0, 1.0)
        found[:, _RIM_TERMS, 0] += share[:, None] * rim_orders(alpha, tilt)
        half_radius = self.dish.sphere_radius_m / self.dish.aperture_radius_m / 2
        facing = 1 / (1 + np.exp((np.pi - tilt - alpha) / _EDGE_SOFTNESS_RAD))
        found[:, TERMS.index((VERTEX, 0)), 0] += np.where(self._behind, half_radius * facing, 0)
        return found

    @property
    def _depth_ratio(self) -> float:
        return round(self.dish.depth_m / self.dish.aperture_radius_m, 6)

    def spectrum(self, k_rad_m: FloatArray) -> ComplexArray:
        """As the renderer asks for, shape (num_mics, num_k)."""
        laid, aperture = self.laid, self.dish.aperture_radius_m
        ka = k_rad_m * aperture
        basis = powers(ka, strengths(self._depth_ratio).highest_ka).astype(np.float32)
        flat = self._coefficients.reshape(-1, NUM_POWERS)
        strength = (flat @ basis.T).reshape(len(laid.tilt_rad), len(TERMS), -1)
        cosines = np.cos(_ORDER_OF_TERM[:, None] * laid.around_rad[_CIRCLE_OF_TERM])
        turns = np.where(_IS_RIM, (-1j) ** _ORDER_OF_TERM, 1.0)[:, None] * cosines
        weights = (turns * laid.spreading[_CIRCLE_OF_TERM] * aperture).astype(np.complex64)
        total = np.zeros((len(laid.tilt_rad), len(k_rad_m)), np.complex64)
        sum_glints(
            total,
            k_rad_m,
            np.where(FOCUSED[:, None], np.sqrt(ka), 1.0).astype(np.float32),
            laid.path_m + (laid.centre_path_m - self.path_m),
            laid.reach_m,
            strength,
            weights,
            _CIRCLE_OF_TERM,
            _ORDER_OF_TERM,
            bessel_table(),
        )
        return np.conj(total)


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
