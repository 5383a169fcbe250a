"""Where a dish's echoes come from: circles on it, each with a way and a Bessel function.

All that a cap returns toward where the sound came from lies on a few circles. A ray of the n-bounce
ring enters at one point and leaves at the opposite one: between two directions ``q`` apart the
circle of radius b sums to J_p(k b q). A point of the rim returns from where it was hit: its circle
sums to J_p of its projection. These factors, the ways and the wavefronts' curvature are formulas;
how strong each order p is, over frequency and tilt, is not: see ``dish_table``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# Circles, and the orders p of the distribution around each; rings are even by reciprocity.
VERTEX, RING_2, RING_3, RING_4, RIM, ACROSS = range(6)
ORDERS: dict[int, tuple[int, ...]] = {
    VERTEX: (0,),
    RING_2: (0, 2, 4, 6),
    RING_3: (0, 2, 4),
    RING_4: (0, 2),
    RIM: (0, 1, 2),
    ACROSS: (0, 2),  # over the edge at one point of the rim, and back over the opposite one
}
TERMS = tuple((circle, order) for circle, orders in ORDERS.items() for order in orders)
_BOUNCES = {RING_2: 2, RING_3: 3, RING_4: 4}
FOCUSED = np.array([circle in _BOUNCES for circle, _ in TERMS])  # strength grows with sqrt(ka)


@dataclass(frozen=True, slots=True, eq=False)
class Glints:
    """The circles of one dish for one source and many receivers.

    path_m : shape (num_circles, num_mics)
        Way by each circle, mean over it, beyond ``centre_path_m``.
    reach_m : shape (num_circles, num_mics)
        Argument of the Bessel functions over k.
    around_rad : shape (num_circles, num_mics)
        Azimuth on the circle that the orders count from.
    centre_path_m : shape (num_mics,)
        Way to the sphere's centre and back.
    tilt_rad : shape (num_mics,)
        Of the axis off the bisector of both directions.
    spreading : shape (num_circles, num_mics)
        1/m^2.
    """

    path_m: FloatArray
    reach_m: FloatArray
    around_rad: FloatArray
    centre_path_m: FloatArray
    tilt_rad: FloatArray
    spreading: FloatArray


def ring(sphere_radius_m: float, bounces: int) -> tuple[float, float]:
    """Radius of the n-bounce ring, and its way beyond that to the sphere's centre, m."""
    incidence = np.pi / 2 * (1 - 1 / bounces)
    way = 2 * bounces * sphere_radius_m * np.cos(incidence)
    return float(sphere_radius_m * np.sin(incidence)), float(way)


def glints(
    aperture_radius_m: float,
    depth_m: float,
    axis: FloatArray,
    to_source_m: FloatArray,
    to_mics_m: FloatArray,
) -> Glints:
    """Lay the circles for a source and microphones, given from the centre of the sphere.

    Parameters
    ----------
    aperture_radius_m, depth_m : float
    axis : shape (3,)
        Unit vector out of the opening.
    to_source_m, to_mics_m : shape (3,) or (num_mics, 3), and (num_mics, 3)
    """
    radius = (aperture_radius_m**2 + depth_m**2) / (2 * depth_m)
    to_source_m = np.broadcast_to(to_source_m, to_mics_m.shape)
    r_s, r_m = np.linalg.norm(to_source_m, axis=1), np.linalg.norm(to_mics_m, axis=1)
    unit_s, unit_m = to_source_m / r_s[:, None], to_mics_m / r_m[:, None]
    bisector = _unit(unit_s + unit_m)
    tilt = np.arccos(np.clip(bisector @ axis, -1, 1))
    # The concave face's vertex lies behind the centre, the convex back's before it.
    side = np.where(tilt > np.pi / 2, -radius, radius)
    vertex = _way(to_source_m, to_mics_m, -side[:, None] * bisector)
    rings = [_near_ring(radius, n, r_s, r_m) for n in _BOUNCES.values()]
    # A tilted rim's echo comes from its nearest and its farthest point.
    edge = aperture_radius_m * _unit(bisector - np.cos(tilt)[:, None] * axis)
    centre = (depth_m - radius) * axis
    nearest, farthest = (_way(to_source_m, to_mics_m, centre + sign * edge) for sign in (1, -1))
    bend = (aperture_radius_m * np.cos(tilt)) ** 2 * (1 / r_s + 1 / r_m) / 2
    across = _way(to_source_m, to_mics_m, centre) + bend + 2 * aperture_radius_m
    path = [vertex, *(way for _, way in rings), (nearest + farthest) / 2, across]

    q, turn = _displacement(unit_s - unit_m, bisector, axis)
    none, rim = np.zeros_like(q), (farthest - nearest) / 2
    reach = [none, *(b * q for b, _ in rings), rim, aperture_radius_m * q]
    far = 1 / (r_s * r_m)
    # A mirror's focus lies between: exact for the vertex on its axis.
    focused = 1 / np.sqrt(r_s * (r_s + side) * r_m * (r_m + side))
    return Glints(
        np.array(path) - (r_s + r_m),
        np.array(reach),
        np.array([none, turn, turn, turn, none, turn]),
        r_s + r_m,
        tilt,
        np.array([focused, far, far, far, far, far]),
    )


def _displacement(
    apart: FloatArray, bisector: FloatArray, axis: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far apart the directions are, and which way from the plane of axis and bisector."""
    sideways = _unit(np.cross(bisector, axis))
    along = np.sum(apart * np.cross(sideways, bisector), axis=1)
    turn = np.arctan2(np.sum(apart * sideways, axis=1), along)
    return np.linalg.norm(apart, axis=1), np.asarray(turn)


def _near_ring(
    sphere_radius_m: float, bounces: int, r_s: FloatArray, r_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Radius and whole way of a ring for finite distances: rays meet it opened by b / r.

    To b^2 (1/r_s + 1/r_m) / 2 beyond the far field's way in first order.
    """
    incidence = np.full(r_s.shape, np.pi / 2 * (1 - 1 / bounces))
    opened_s = opened_m = np.zeros_like(r_s)
    for _ in range(6):
        b = sphere_radius_m * np.sin(incidence)
        opened_s, opened_m = np.arcsin(np.minimum(b / r_s, 1)), np.arcsin(np.minimum(b / r_m, 1))
        incidence = np.pi / 2 * (1 - 1 / bounces) - (opened_s + opened_m) / (2 * bounces)
    way = r_s * np.cos(opened_s) + r_m * np.cos(opened_m)
    return b, way + 2 * bounces * sphere_radius_m * np.cos(incidence)


def _unit(vectors: FloatArray) -> FloatArray:
    """Of length 1; what has none stays without."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)[:, None])


def _way(source_m: FloatArray, mics_m: FloatArray, by_m: FloatArray) -> FloatArray:
    there, back = np.linalg.norm(source_m - by_m, axis=1), np.linalg.norm(mics_m - by_m, axis=1)
    return np.asarray(there + back)
