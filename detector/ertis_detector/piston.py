"""Beam pattern of the emitter, as a circular piston."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import j1

PISTON_RADIUS_M = 0.013  # effective radius of a SensComp 7000


def piston_pattern(
    wavenumber: npt.NDArray[np.float64], sin_angle: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Directivity of a circular piston, 2 J1(x) / x with x = k a sin(angle); broadcasts.

    Parameters
    ----------
    wavenumber : float64
        k = 2 pi f / c, rad/m.
    sin_angle : float64
        Sine of the angle off the axis.
    """
    x = np.maximum(wavenumber * PISTON_RADIUS_M * np.abs(sin_angle), 1e-6)
    return np.asarray(2 * j1(x) / x)
