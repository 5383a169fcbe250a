"""What stands in the way: how much of a dish the sonar sees past objects.

Rays from the sonar to points of the aperture; diffraction around the blocker is left out, which
matters where the shadow's edge runs through the dish.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

CYLINDER_SIDES = 12
_RINGS = ((0.0, 1), (0.5, 6), (0.9, 12))  # of aperture radii, and points on each
_AROUND_RAD = np.concatenate([2 * np.pi * np.arange(count) / count for _, count in _RINGS])
_FROM_CENTRE = np.concatenate([np.full((count, 1), part) for part, count in _RINGS])
_ACROSS, _UP = np.cos(_AROUND_RAD), np.sin(_AROUND_RAD)


@dataclass(frozen=True, slots=True, eq=False)
class Blocker:
    """An upright prism.

    corners_m : shape (k, 2)
        Convex, counter-clockwise, seen from above.
    base_m, top_m : float
    opacity : float
        1 lets nothing through; amplitude.
    """

    corners_m: FloatArray
    base_m: float
    top_m: float
    opacity: float = 1.0

    @classmethod
    def prism(cls, corners_m: FloatArray, base_m: float, top_m: float) -> Blocker:
        """A box or the like."""
        return cls(corners_m, base_m, top_m)

    @classmethod
    def cylinder(
        cls,
        x_m: float,
        y_m: float,
        radius_m: float,
        base_m: float,
        top_m: float,
        opacity: float = 1,
    ) -> Blocker:
        """A pipe, a bush: a prism of twelve sides."""
        angle = 2 * np.pi * np.arange(CYLINDER_SIDES) / CYLINDER_SIDES
        circle = radius_m * np.column_stack([np.cos(angle), np.sin(angle)])
        return cls(circle + np.array([x_m, y_m]), base_m, top_m, opacity)

    def shifted(self, offset_m: FloatArray) -> Blocker:
        """The same elsewhere."""
        return Blocker(self.corners_m + offset_m[:2], self.base_m, self.top_m, self.opacity)

    def hits(self, start_m: FloatArray, ends_m: FloatArray) -> npt.NDArray[np.bool_]:
        """Which segments from ``start_m`` (3,) to ``ends_m`` (n, 3) it cuts, shape (n,)."""
        return _hits(self.corners_m, self.base_m, self.top_m, start_m, ends_m)


@numba.njit(cache=True, nogil=True)
def _hits(
    corners_m: FloatArray, base_m: float, top_m: float, start_m: FloatArray, ends_m: FloatArray
) -> npt.NDArray[np.bool_]:
    """Segment by segment, clipped by each face in turn: sides first, then top and bottom."""
    sides = len(corners_m)
    found = np.empty(len(ends_m), np.bool_)
    for n in range(len(ends_m)):
        way = ends_m[n] - start_m
        enter, leave = 0.0, 1.0
        for face in range(sides + 2):
            if face < sides:
                x, y = corners_m[face, 0], corners_m[face, 1]
                after = corners_m[(face + 1) % sides]
                out_x, out_y = after[1] - y, x - after[0]
                rate = way[0] * out_x + way[1] * out_y
                room = (x - start_m[0]) * out_x + (y - start_m[1]) * out_y
            elif face == sides:
                rate, room = way[2], top_m - start_m[2]
            else:
                rate, room = -way[2], start_m[2] - base_m
            # Inside this face where rate * t <= room.
            if rate > 0:
                leave = min(leave, room / rate)
            elif rate < 0:
                enter = max(enter, room / rate)
            elif room < 0:
                leave = -1.0
        found[n] = enter < leave
    return found


def clear_part(
    sonar_m: FloatArray,
    rim_centre_m: FloatArray,
    axis: FloatArray,
    radius_m: float,
    blockers: Sequence[Blocker],
) -> float:
    """Part of a dish's aperture that the sonar sees: 1 all, 0 nothing; world frame.

    Parameters
    ----------
    sonar_m, rim_centre_m, axis : shape (3,)
    radius_m : of the aperture
    """
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = _cross(axis, helper)
    across /= np.linalg.norm(across)
    up = _cross(axis, across)
    ring = np.outer(_ACROSS, across) + np.outer(_UP, up)
    ends = rim_centre_m + _FROM_CENTRE * radius_m * ring
    seen = np.ones(len(ends))
    for blocker in blockers:
        seen[blocker.hits(sonar_m, ends)] *= 1 - blocker.opacity
    return float(seen.mean())


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """As ``np.cross``, which takes longer than all the rest here for two vectors."""
    (a0, a1, a2), (b0, b1, b2) = a, b
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])
