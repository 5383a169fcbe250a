"""The geometry of a dish's circles, one source and one receiver at a time."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
_Vector = tuple[float, float, float]

VERTEX, RING_2, RING_3, RING_4, RIM, ACROSS = range(6)


@numba.njit(cache=True, nogil=True)
def _norm(a: _Vector) -> float:
    return float(np.sqrt(a[0] ** 2 + a[1] ** 2 + a[2] ** 2))


@numba.njit(cache=True, nogil=True)
def _unit(a: _Vector) -> _Vector:
    """Of length 1; what has none stays without."""
    size = max(_norm(a), 1e-12)
    return a[0] / size, a[1] / size, a[2] / size


@numba.njit(cache=True, nogil=True)
def _sum(a: _Vector, share: float, b: _Vector) -> _Vector:
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@numba.njit(cache=True, nogil=True)
def _dot(a: _Vector, b: _Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True)
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@numba.njit(cache=True, nogil=True)
def _way(source: _Vector, mic: _Vector, by: _Vector) -> float:
    return _norm(_sum(source, -1.0, by)) + _norm(_sum(mic, -1.0, by))


@numba.njit(cache=True, nogil=True)
def _near_ring(sphere_radius_m: float, bounces: int, r_s: float, r_m: float) -> _Vector:
    """Radius and whole way of a ring for finite distances: rays meet it opened by b / r.

    To b^2 (1/r_s + 1/r_m) / 2 beyond the far field's way in first order.
    """
    far = np.pi / 2 * (1 - 1 / bounces)
    incidence, b, opened_s, opened_m = far, 0.0, 0.0, 0.0
    for _ in range(6):
        b = sphere_radius_m * np.sin(incidence)
        opened_s, opened_m = np.arcsin(min(b / r_s, 1.0)), np.arcsin(min(b / r_m, 1.0))
        incidence = far - (opened_s + opened_m) / (2 * bounces)
    way = r_s * np.cos(opened_s) + r_m * np.cos(opened_m)
    return b, way + 2 * bounces * sphere_radius_m * np.cos(incidence), incidence


@numba.njit(cache=True, nogil=True)
def lay_circles(
    aperture_radius_m: float,
    depth_m: float,
    axis: FloatArray,
    sources_m: FloatArray,
    mics_m: FloatArray,
    path: FloatArray,
    reach: FloatArray,
    around: FloatArray,
    centre_path: FloatArray,
    tilt: FloatArray,
    spreading: FloatArray,
) -> None:
    """Fill the arrays of :class:`ertis_simulator.glints.Glints`.

    axis : shape (3,)
    sources_m, mics_m : shape (num_mics, 3), from the centre of the sphere
    path, reach, around, spreading : shape (num_circles, num_mics), written
    centre_path, tilt : shape (num_mics,), written
    """
    radius = (aperture_radius_m**2 + depth_m**2) / (2 * depth_m)
    up = (axis[0], axis[1], axis[2])
    for n in range(len(mics_m)):
        source = (sources_m[n, 0], sources_m[n, 1], sources_m[n, 2])
        mic = (mics_m[n, 0], mics_m[n, 1], mics_m[n, 2])
        r_s, r_m = _norm(source), _norm(mic)
        unit_s, unit_m = _unit(source), _unit(mic)
        bisector = _unit(_sum(unit_s, 1.0, unit_m))
        cosine = min(max(_dot(bisector, up), -1.0), 1.0)
        tilt[n], centre_path[n] = np.arccos(cosine), r_s + r_m
        # The concave face's vertex lies behind the centre, the convex back's before it.
        side = -radius if cosine < 0 else radius
        zero = (0.0, 0.0, 0.0)
        path[VERTEX, n] = _way(source, mic, _sum(zero, -side, bisector)) - (r_s + r_m)
        # How far apart the directions are, and which way from the plane of axis and bisector.
        apart = _sum(unit_s, -1.0, unit_m)
        sideways = _unit(_cross(bisector, up))
        along, q = _dot(apart, _cross(sideways, bisector)), _norm(apart)
        turn = np.arctan2(_dot(apart, sideways), along)
        for bounces in range(2, 5):
            b, way, _ = _near_ring(radius, bounces, r_s, r_m)
            circle = RING_2 + bounces - 2
            path[circle, n], reach[circle, n] = way - (r_s + r_m), b * q
        # A tilted rim's echo comes from its nearest and its farthest point.
        edge = _unit(_sum(bisector, -cosine, up))
        centre = _sum(zero, depth_m - radius, up)
        nearest = _way(source, mic, _sum(centre, aperture_radius_m, edge))
        farthest = _way(source, mic, _sum(centre, -aperture_radius_m, edge))
        path[RIM, n] = (nearest + farthest) / 2 - (r_s + r_m)
        bend = (aperture_radius_m * cosine) ** 2 * (1 / r_s + 1 / r_m) / 2
        way = _way(source, mic, centre) + bend + 2 * aperture_radius_m
        path[ACROSS, n] = way - (r_s + r_m)
        reach[VERTEX, n], reach[RIM, n] = 0.0, (farthest - nearest) / 2
        reach[ACROSS, n] = aperture_radius_m * q
        around[:, n] = turn
        around[VERTEX, n], around[RIM, n] = 0.0, 0.0
        spreading[:, n] = 1 / (r_s * r_m)
        # A mirror's focus lies between: exact for the vertex on its axis.
        spreading[VERTEX, n] = 1 / np.sqrt(r_s * (r_s + side) * r_m * (r_m + side))
