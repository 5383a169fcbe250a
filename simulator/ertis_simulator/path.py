"""Where the sonar or an object is: a pose, and a path through waypoints with times."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

WALL_GAP_M = 0.3  # what rolls to and fro turns back so near to a wall


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the sonar is: position (m, world frame) and heading (rad, + left)."""

    position_m: tuple[float, float, float]
    yaw_rad: float

    def to_sensor(self, points_m: FloatArray) -> FloatArray:
        """World points, shape (..., 3), in the sensor frame."""
        return self.turn(points_m - np.asarray(self.position_m))

    def turn(self, vectors: FloatArray) -> FloatArray:
        """World directions, shape (..., 3), in the sensor frame."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.asarray(vectors @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


@dataclass(frozen=True, slots=True)
class Path:
    """Straight from waypoint to waypoint, at rest before the first and after the last.

    times_s : strictly rising
    points_m : (x, y) at those times, world frame
    yaw_rad : heading at those times; turned through as written, so that 190 degrees after 170 is
        a turn of 20
    """

    times_s: tuple[float, ...]
    points_m: tuple[tuple[float, float], ...]
    yaw_rad: tuple[float, ...]

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return x, y and heading at a time."""
        x, y = zip(*self.points_m, strict=True)
        return (
            float(np.interp(time_s, self.times_s, x)),
            float(np.interp(time_s, self.times_s, y)),
            float(np.interp(time_s, self.times_s, self.yaw_rad)),
        )

    def offset_m(self, time_s: float) -> FloatArray:
        """How far it is from its first waypoint at a time, shape (3,)."""
        x, y, _ = self.at(time_s)
        return np.array([x - self.points_m[0][0], y - self.points_m[0][1], 0.0])


def to_and_fro(start: float, way: float, walls: tuple[float, float]) -> float:
    """Where on an axis something is that has come ``way`` from ``start``, m.

    It turns back ``WALL_GAP_M`` before each wall, or where it started if that is nearer to one.
    """
    low, high = min(walls[0] + WALL_GAP_M, start), max(walls[1] - WALL_GAP_M, start)
    if low <= start + way <= high:
        return start + way
    if math.isinf(high - low):  # one wall: no way back from the other side
        return high - abs(start + way - high) if math.isinf(low) else low + abs(start + way - low)
    width = high - low
    if not width:
        return start
    place = (start + way - low) % (2 * width)
    return low + min(place, 2 * width - place)
