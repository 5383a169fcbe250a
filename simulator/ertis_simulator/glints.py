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

from ertis_simulator.circles import ACROSS, RIM, RING_2, RING_3, RING_4, VERTEX, lay_circles

FloatArray = npt.NDArray[np.float64]

# Circles, and the orders p of the distribution around each; rings are even by reciprocity.
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
    mics_m = np.ascontiguousarray(to_mics_m, np.float64)
    sources_m = np.ascontiguousarray(np.broadcast_to(to_source_m, mics_m.shape), np.float64)
    circles = len(ORDERS)
    path, reach, around, spreading = (np.empty((circles, len(mics_m))) for _ in range(4))
    centre_path, tilt = np.empty(len(mics_m)), np.empty(len(mics_m))
    lay_circles(
        aperture_radius_m,
        depth_m,
        np.asarray(axis, np.float64),
        sources_m,
        mics_m,
        path,
        reach,
        around,
        centre_path,
        tilt,
        spreading,
    )
    return Glints(path, reach, around, centre_path, tilt, spreading)
