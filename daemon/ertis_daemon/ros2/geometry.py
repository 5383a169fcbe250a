"""From range and bearing to what ROS wants: position, orientation, covariance in x, y, z."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

# Where the detector could not tell: a uniform angle over the half space ahead, a range over 6 m.
UNKNOWN_ANGLE_VARIANCE = math.pi**2 / 12.0
UNKNOWN_RANGE_VARIANCE = 6.0**2 / 12.0
# Of the orientation, rad2: large enough for graph optimisers to leave it out (RTAB-Map's value).
ROTATION_VARIANCE = 9999.0


def position(range_m: float, azimuth_rad: float, elevation_rad: float) -> Float:
    """Cartesian: x forward, y left, z up (REP-103), m; an angle that is not finite counts as 0."""
    azimuth, elevation = _finite(azimuth_rad), _finite(elevation_rad)
    level_m = range_m * math.cos(elevation)
    return np.array(
        [
            level_m * math.cos(azimuth),
            level_m * math.sin(azimuth),
            range_m * math.sin(elevation),
        ]
    )


def line_of_sight(azimuth_rad: float, elevation_rad: float) -> Float:
    """Quaternion (x, y, z, w) whose x axis points from the sonar to the landmark.

    A turn by the azimuth around z, then by minus the elevation around the new y.
    """
    yaw, pitch = _finite(azimuth_rad) / 2.0, -_finite(elevation_rad) / 2.0
    cy, sy = math.cos(yaw), math.sin(yaw)
    cp, sp = math.cos(pitch), math.sin(pitch)
    return np.array([-sp * sy, sp * cy, cp * sy, cp * cy])


def cartesian_covariance(
    range_m: float,
    azimuth_rad: float,
    elevation_rad: float,
    covariance: Sequence[Sequence[float]],
) -> Float:
    """Covariance of (x, y, z) to first order: J C J', with J the derivative of ``position``.

    Parameters
    ----------
    covariance : 3 x 3, of (range, azimuth, elevation)
        m2, m rad, rad2. A variance that is not finite is replaced by that of knowing nothing.

    Returns
    -------
    float64, shape (3, 3)
        m2, symmetric.
    """
    azimuth, elevation = _finite(azimuth_rad), _finite(elevation_rad)
    cos_a, sin_a = math.cos(azimuth), math.sin(azimuth)
    cos_e, sin_e = math.cos(elevation), math.sin(elevation)
    jacobian = np.array(
        [
            [cos_e * cos_a, -range_m * cos_e * sin_a, -range_m * sin_e * cos_a],
            [cos_e * sin_a, range_m * cos_e * cos_a, -range_m * sin_e * sin_a],
            [sin_e, 0.0, range_m * cos_e],
        ]
    )
    spherical = _known(np.array(covariance, dtype=np.float64))
    result = jacobian @ spherical @ jacobian.T
    symmetric: Float = (result + result.T) / 2.0
    return symmetric


def pose_covariance(xyz_m2: Float) -> Float:
    """Row-major 6 x 6 of a ROS pose (x, y, z, rotations): the position's, rotations unknown."""
    full = np.zeros((6, 6))
    full[:3, :3] = xyz_m2
    full[range(3, 6), range(3, 6)] = ROTATION_VARIANCE
    return full.ravel()


def _known(covariance: Float) -> Float:
    unknown = np.array([UNKNOWN_RANGE_VARIANCE, UNKNOWN_ANGLE_VARIANCE, UNKNOWN_ANGLE_VARIANCE])
    lost = ~np.isfinite(np.diag(covariance))
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    known[lost, :] = 0.0
    known[:, lost] = 0.0
    known[lost, lost] = unknown[lost]
    return known


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0
