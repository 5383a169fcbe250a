"""What stands in the way: how much of a dish the sonar sees past objects.

Rays from the sonar to points of the aperture; diffraction around the blocker is left out, which
matters where the shadow's edge runs through the dish.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

CYLINDER_SIDES = 12
_RINGS = ((0.0, 1), (0.5, 6), (0.9, 12))  # of aperture radii, and points on each


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
        way = ends_m - start_m
        edge = np.roll(self.corners_m, -1, axis=0) - self.corners_m
        outward = np.column_stack([edge[:, 1], -edge[:, 0]])
        # Inside each face where rate * t <= room; sides first, then top and bottom.
        rate = np.column_stack([way[:, :2] @ outward.T, way[:, 2], -way[:, 2]])
        room = np.append(
            np.sum((self.corners_m - start_m[:2]) * outward, axis=1),
            [self.top_m - start_m[2], start_m[2] - self.base_m],
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            at = room / rate
        leave = np.where(rate > 0, at, np.where((rate == 0) & (room < 0), -1.0, 1.0)).min(axis=1)
        enter = np.where(rate < 0, at, 0.0).max(axis=1)
        leave, enter = np.minimum(leave, 1.0), np.maximum(enter, 0.0)
        return np.asarray(enter < leave)


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
    across = np.cross(axis, helper)
    across /= np.linalg.norm(across)
    up = np.cross(axis, across)
    points = []
    for part, count in _RINGS:
        angle = 2 * np.pi * np.arange(count) / count
        ring = np.outer(np.cos(angle), across) + np.outer(np.sin(angle), up)
        points.append(rim_centre_m + part * radius_m * ring)
    ends = np.concatenate(points)
    seen = np.ones(len(ends))
    for blocker in blockers:
        seen = seen * np.where(blocker.hits(sonar_m, ends), 1 - blocker.opacity, 1.0)
    return float(seen.mean())
