"""How the sensor moved between two pings: by odometry, or as far as it may have."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

# Of wheel odometry over one ping period; wheels that slip do worse, and say so by a covariance.
DRIFT_M, DRIFT_PER_M = 0.0005, 0.05
DRIFT_RAD, DRIFT_PER_RAD, DRIFT_RAD_PER_M = math.radians(0.02), 0.05, math.radians(1.0)


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """Where something is in the plane: x and y, and its heading, + left."""

    x_m: float
    y_m: float
    yaw_rad: float

    def then(self, step: PlanarPose) -> PlanarPose:
        """The pose that ``step`` is, seen from this one, in the frame of this one."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return PlanarPose(
            self.x_m + c * step.x_m - s * step.y_m,
            self.y_m + s * step.x_m + c * step.y_m,
            wrap(self.yaw_rad + step.yaw_rad),
        )

    def seen_from(self, other: PlanarPose) -> PlanarPose:
        """Tell it in the frame that ``other`` spans."""
        c, s = math.cos(other.yaw_rad), math.sin(other.yaw_rad)
        x, y = self.x_m - other.x_m, self.y_m - other.y_m
        return PlanarPose(c * x + s * y, c * y - s * x, wrap(self.yaw_rad - other.yaw_rad))


NO_STEP = PlanarPose(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What the sensor did from one ping to the next.

    step : PlanarPose
        Where it is now, seen from where it was: sensor frame, x forward.
    covariance : float64, shape (3, 3)
        Of x, y and yaw; m2, m rad, rad2.
    """

    step: PlanarPose
    covariance: Float

    @classmethod
    def between(cls, before: PlanarPose, after: PlanarPose) -> Motion:
        """Motion between two poses of the sensor, as uncertain as wheels make it."""
        step = after.seen_from(before)
        length_m, turn_rad = math.hypot(step.x_m, step.y_m), abs(step.yaw_rad)
        place_m = DRIFT_M + DRIFT_PER_M * length_m
        yaw_rad = DRIFT_RAD + DRIFT_PER_RAD * turn_rad + DRIFT_RAD_PER_M * length_m
        return cls(step, np.diag(np.square([place_m, place_m, yaw_rad])))

    def is_more_than_noise(self) -> bool:
        """Whether the sensor moved for sure: by more than four sigma in x, y or yaw."""
        step = np.array([self.step.x_m, self.step.y_m, self.step.yaw_rad])
        return bool((step**2 > 16.0 * self.covariance.diagonal()).any())

    @classmethod
    def unknown(cls, elapsed_s: float, max_speed_m_s: float, max_turn_rad_s: float) -> Motion:
        """Any motion within limits, which are taken for two sigma, around none at all."""
        place_m = max_speed_m_s * elapsed_s / 2
        yaw_rad = max_turn_rad_s * elapsed_s / 2
        return cls(NO_STEP, np.diag(np.square([place_m, place_m, yaw_rad])))


def wrap(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % math.tau
