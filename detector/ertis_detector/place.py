"""Where a landmark is: a Kalman filter on a fixed point, seen from a sensor that moves.

An echo heard twice from the same spot is wrong by the same amount twice: what the detector's
covariance speaks of is mostly not noise but the pattern of the rings, the clutter around, the
array's own error. So the error of a detection has three parts, each with its share of the stated
covariance: one that stays with the landmark, one that changes as the sensor moves, one that is new
at every ping. Only the last two average out, and the second only by moving.
"""

from __future__ import annotations

import math

import numpy as np

from ertis_detector.detection import Detection
from ertis_detector.motion import Float, Motion, wrap
from ertis_detector.views import PLACE_LENGTHS, likeness

STAYING_SHARE, NOISE_SHARE = 0.25, 0.10  # of a detection's variance; assumed
_MOVING_SHARE = 1.0 - STAYING_SHARE - NOISE_SHARE
# Below it a covariance is not believed: a tenth of the spacing of samples, of a beam's step.
_LEAST_SIGMA = np.array([1e-3, 2e-3, 4e-3])
_LEAST_ACROSS_M = 1e-3
GATE = 16.27  # 99.9 % of a landmark's own detections (chi-squared, 3 degrees of freedom)


class Measured:
    """A detection as the filter sees it: its place, the covariance, and that one's root."""

    def __init__(self, detection: Detection) -> None:
        covariance = np.array(detection.covariance, float)
        self.seen = np.array([detection.range_m, detection.azimuth_rad, detection.elevation_rad])
        self.noise = (covariance + covariance.T) / 2 + np.diag(_LEAST_SIGMA**2)
        self.root = np.linalg.cholesky(self.noise)


class Place:
    """Position of one landmark, x forward, y left, z up, m, with the error that is not noise.

    The state is the position and, in units of its sigma, the part of the detections' error (range,
    azimuth, elevation) that changes slowly.
    """

    def __init__(self, first: Measured) -> None:
        self._noise = first.noise
        self._mean = np.zeros(6)
        self._mean[:3] = _cartesian(first.seen)
        self._look()
        along = np.linalg.inv(self._slopes) @ first.root
        self._covariance = np.eye(6)
        self._covariance[:3, :3] = (1.0 - STAYING_SHARE) * along @ along.T
        self._covariance[:3, 3:] = -math.sqrt(_MOVING_SHARE) * along
        self._covariance[3:, :3] = self._covariance[:3, 3:].T

    def _look(self) -> None:
        self.seen = _spherical(self._mean[:3])  # range, azimuth and elevation, m and rad
        self._slopes = _slopes(self._mean[:3])

    def seen_covariance(self) -> Float:
        """Of range, azimuth and elevation, whatever the reason for the error."""
        slopes = self._slopes
        inner = slopes @ self._covariance[:3, :3] @ slopes.T + STAYING_SHARE * self._noise
        return np.asarray((inner + inner.T) / 2)

    def move(self, motion: Motion, *, is_known: bool) -> float:
        """Let the sensor move.

        Parameters
        ----------
        motion : Motion
        is_known : bool
            Whether odometry tells it. If not, the slow part of the error is taken to stay as it is.

        Returns
        -------
        float
            By how much the line of sight turned, seen from outside, rad; + left.
        """
        step, before = motion.step, self.seen
        c, s = math.cos(step.yaw_rad), math.sin(step.yaw_rad)
        x, y = self._mean[0] - step.x_m, self._mean[1] - step.y_m
        x, y = c * x + s * y, c * y - s * x
        self._mean[:2] = x, y
        self._look()
        change = self.seen - before
        side_rad = wrap(float(change[1]) + step.yaw_rad) if is_known else 0.0
        alike = 1.0
        if is_known and motion.is_more_than_noise():  # or standing still would add up to a walk
            view = np.array([side_rad, change[0], change[1]])
            alike = float(likeness(view, np.zeros(3), PLACE_LENGTHS))
        whole = np.diag([1.0, 1.0, 1.0, alike, alike, alike])
        whole[0, :2], whole[1, :2] = (c, s), (-s, c)
        by_motion = np.array([[-c, -s, y], [s, -c, -x], [0.0, 0.0, 0.0]])
        self._mean[3:] *= alike
        self._covariance = whole @ self._covariance @ whole.T
        self._covariance[:3, :3] += by_motion @ motion.covariance @ by_motion.T
        self._covariance[3:, 3:] += (1.0 - alike**2) * np.eye(3)
        return side_rad

    def is_near(self, measured: Measured) -> bool:
        """Whether a look at the range alone leaves a detection possible; quickly told."""
        slopes = self._slopes[0]
        variance = slopes @ self._covariance[:3, :3] @ slopes + measured.noise[0, 0]
        return bool((measured.seen[0] - self.seen[0]) ** 2 <= GATE * variance)

    def surprise(self, measured: Measured) -> tuple[float, float]:
        """Squared Mahalanobis distance of a detection, and its log density, 1/(m rad2)."""
        gap, spread, _ = self._expect(measured)
        spread = spread + STAYING_SHARE * measured.noise
        root = np.linalg.cholesky(spread)
        scaled = np.linalg.solve(root, gap)
        squared = float(scaled @ scaled)
        log_det = 2.0 * float(np.log(root.diagonal()).sum())
        return squared, -0.5 * (squared + log_det + 3 * math.log(math.tau))

    def update(self, measured: Measured) -> None:
        """Take a detection of this landmark in."""
        gap, spread, slopes = self._expect(measured)
        gain = np.linalg.solve(spread, slopes @ self._covariance).T
        self._mean = self._mean + gain @ gap
        left = np.eye(6) - gain @ slopes
        # Joseph's form: stays positive definite after a million pings.
        own = gain @ (NOISE_SHARE * measured.noise) @ gain.T
        joined = left @ self._covariance @ left.T + own
        self._covariance = (joined + joined.T) / 2
        self._noise = measured.noise
        self._look()

    def _expect(self, measured: Measured) -> tuple[Float, Float, Float]:
        """Innovation, its covariance but for the part that stays, and slopes of the state."""
        slow = math.sqrt(_MOVING_SHARE) * measured.root
        slopes = np.concatenate([self._slopes, slow], axis=1)
        gap = measured.seen - self.seen - slow @ self._mean[3:]
        gap[1] = wrap(gap[1])
        spread = slopes @ self._covariance @ slopes.T + NOISE_SHARE * measured.noise
        return gap, np.asarray(spread), slopes


def _cartesian(seen: Float) -> Float:
    r, azimuth, elevation = seen
    across = r * math.cos(elevation)
    return np.array(
        [across * math.cos(azimuth), across * math.sin(azimuth), r * math.sin(elevation)]
    )


def _spherical(point: Float) -> Float:
    x, y, z = point
    across = math.hypot(x, y)
    return np.array([math.hypot(across, z), math.atan2(y, x), math.atan2(z, across)])


def _slopes(point: Float) -> Float:
    """Derivatives of range, azimuth and elevation by x, y and z, shape (3, 3)."""
    x, y, z = point
    across = max(math.hypot(x, y), _LEAST_ACROSS_M)  # overhead, azimuth has no slope
    r = math.hypot(across, z)
    return np.array(
        [
            [x / r, y / r, z / r],
            [-y / across**2, x / across**2, 0.0],
            [-x * z / (r**2 * across), -y * z / (r**2 * across), across / r**2],
        ]
    )
