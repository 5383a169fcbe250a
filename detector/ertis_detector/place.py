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
from ertis_detector.motion import NO_STEP, Float, Motion, wrap
from ertis_detector.views import PLACE_LENGTHS, likeness

STAYING_SHARE, NOISE_SHARE = 0.25, 0.10  # of a detection's variance; assumed
_MOVING_SHARE = 1.0 - STAYING_SHARE - NOISE_SHARE
# Below it a covariance is not believed: a tenth of the spacing of samples, of a beam's step.
_LEAST_NOISE = np.diag(np.square([1e-3, 2e-3, 4e-3]))
_LEAST_ACROSS_M = 1e-3
_EYE_3, _EYE_6 = np.eye(3), np.eye(6)
GATE = 16.27  # 99.9 % of a landmark's own detections (chi-squared, 3 degrees of freedom)


class Measured:
    """A detection as the filter sees it.

    Attributes
    ----------
    seen : float64, shape (3,)
        Range, azimuth and elevation, m and rad.
    noise, root : float64, shape (3, 3)
        Their covariance, and its lower root.
    told : float64, shape (3, 6)
        What of a ``Place``'s state it tells.
    """

    def __init__(self, detection: Detection) -> None:
        covariance = np.array(detection.covariance, float)
        self.seen = np.array([detection.range_m, detection.azimuth_rad, detection.elevation_rad])
        self.noise = (covariance + covariance.T) / 2 + _LEAST_NOISE
        self.root = _lower(_root(self.noise))
        self.told = np.concatenate([_EYE_3, math.sqrt(_MOVING_SHARE) * self.root], axis=1)


class Place:
    """Where one landmark is seen from the sensor, with the error that is not noise.

    The state is what a detection tells, range, azimuth and elevation, and, in units of its sigma,
    the part of the detections' error that changes slowly. In these coordinates a sensor that stands
    still learns nothing of that error. In Cartesian ones it would seem to, by linearising the same
    thing at a slightly other point at each ping.

    Attributes
    ----------
    seen : float64, shape (3,)
        Range, azimuth and elevation, m and rad.
    """

    def __init__(self, first: Measured) -> None:
        self._noise = first.noise
        self.seen = first.seen.copy()
        self._slow = np.zeros(3)
        self._covariance = np.eye(6)
        self._covariance[:3, :3] = (1.0 - STAYING_SHARE) * first.noise
        self._covariance[:3, 3:] = -math.sqrt(_MOVING_SHARE) * first.root
        self._covariance[3:, :3] = self._covariance[:3, 3:].T

    def seen_covariance(self) -> Float:
        """Of range, azimuth and elevation, whatever the reason for the error."""
        return np.asarray(self._covariance[:3, :3] + STAYING_SHARE * self._noise)

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
        point = _cartesian(self.seen)
        if motion.step == NO_STEP:  # what is not known to move: the short way to the same
            by_motion = _slopes(point) @ _by_motion(1.0, 0.0, point)
            self._covariance[:3, :3] += by_motion @ motion.covariance @ by_motion.T
            return 0.0
        step, before = motion.step, self.seen
        c, s = math.cos(step.yaw_rad), math.sin(step.yaw_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        moved = turn @ (point - (step.x_m, step.y_m, 0.0))
        self.seen = _spherical(moved)
        change = self.seen - before
        side_rad = wrap(float(change[1]) + step.yaw_rad) if is_known else 0.0
        alike = 1.0
        if is_known and motion.is_more_than_noise():  # or standing still would add up to a walk
            view = np.array([side_rad, change[0], change[1]])
            alike = float(likeness(view, np.zeros(3), PLACE_LENGTHS))
        slopes = _slopes(moved)
        by_place = slopes @ turn @ _slopes_back(point)
        by_motion = slopes @ _by_motion(c, s, moved)
        self._slow = alike * self._slow
        p = self._covariance
        p[:3, :3] = by_place @ p[:3, :3] @ by_place.T + by_motion @ motion.covariance @ by_motion.T
        p[:3, 3:] = alike * (by_place @ p[:3, 3:])
        p[3:, :3] = p[:3, 3:].T
        if alike < 1.0:
            p[3:, 3:] = alike**2 * p[3:, 3:] + (1.0 - alike**2) * _EYE_3
        return side_rad

    def is_near(self, measured: Measured) -> bool:
        """Whether a look at the range alone leaves a detection possible; quickly told."""
        variance = self._covariance[0, 0] + measured.noise[0, 0]
        return bool((measured.seen[0] - self.seen[0]) ** 2 <= GATE * variance)

    def surprise(self, measured: Measured) -> tuple[float, float]:
        """Squared Mahalanobis distance of a detection, and its log density, 1/(m rad2)."""
        gap, spread, _ = self._expect(measured)
        root = _root(spread + STAYING_SHARE * measured.noise)
        (a, b, c, d, e, f), (x, y, z) = root, gap.tolist()
        x /= a
        y = (y - b * x) / c
        z = (z - d * x - e * y) / f
        squared = x * x + y * y + z * z
        log_det = 2.0 * math.log(a * c * f)
        return squared, -0.5 * (squared + log_det + 3 * math.log(math.tau))

    def update(self, measured: Measured) -> None:
        """Take a detection of this landmark in."""
        gap, spread, shared = self._expect(measured)
        gain = (_inverse(spread) @ shared).T
        change = gain @ gap
        self.seen = self.seen + change[:3]
        self.seen[1] = wrap(float(self.seen[1]))
        self._slow = self._slow + change[3:]
        left = _EYE_6 - gain @ measured.told
        # Joseph's form: stays positive definite after a million pings.
        own = gain @ (NOISE_SHARE * measured.noise) @ gain.T
        joined = left @ self._covariance @ left.T + own
        self._covariance = (joined + joined.T) / 2
        self._noise = measured.noise

    def _expect(self, measured: Measured) -> tuple[Float, Float, Float]:
        """Innovation, its covariance but for the part that stays, and what it tells of the state.

        The last of shape (3, 6): the detection's ``told``, times the state's covariance.
        """
        told = measured.told
        gap = measured.seen - self.seen - told[:, 3:] @ self._slow
        gap[1] = wrap(float(gap[1]))
        shared = told @ self._covariance
        return gap, shared @ told.T + NOISE_SHARE * measured.noise, shared


def _by_motion(c: float, s: float, moved: Float) -> Float:
    """Derivatives of a point by the sensor's x, y and yaw; cosine and sine of its turn given."""
    return np.array([[-c, -s, moved[1]], [s, -c, -moved[0]], [0.0, 0.0, 0.0]])


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


def _slopes_back(point: Float) -> Float:
    """Derivatives of x, y and z by range, azimuth and elevation: the inverse of ``_slopes``."""
    x, y, z = point
    across = max(math.hypot(x, y), _LEAST_ACROSS_M)
    r = math.hypot(across, z)
    return np.array(
        [[x / r, -y, -x * z / across], [y / r, x, -y * z / across], [z / r, 0.0, across]]
    )


# For matrices this small a call to LAPACK takes ten times as long as the arithmetic.


def _root(matrix: Float) -> tuple[float, float, float, float, float, float]:
    """Lower Cholesky root of a symmetric 3 x 3 matrix, row by row, without what is 0.

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive definite.
    """
    (xx, _, _), (xy, yy, _), (xz, yz, zz) = matrix.tolist()
    try:
        a = math.sqrt(xx)
        b, d = xy / a, xz / a
        c = math.sqrt(yy - b * b)
        e = (yz - d * b) / c
        f = math.sqrt(zz - d * d - e * e)
    except (ValueError, ZeroDivisionError):
        f = 0.0
    if f == 0.0:
        raise np.linalg.LinAlgError(f"covariance {matrix.tolist()} is not positive definite")
    return a, b, c, d, e, f


def _lower(root: tuple[float, float, float, float, float, float]) -> Float:
    a, b, c, d, e, f = root
    return np.array([[a, 0.0, 0.0], [b, c, 0.0], [d, e, f]])


def _inverse(matrix: Float) -> Float:
    """Of a symmetric positive definite 3 x 3 matrix, by its root."""
    a, b, c, d, e, f = _root(matrix)
    back = np.array(
        [
            [1.0 / a, 0.0, 0.0],
            [-b / (a * c), 1.0 / c, 0.0],
            [(b * e - c * d) / (a * c * f), -e / (c * f), 1.0 / f],
        ]
    )
    return np.asarray(back.T @ back)
