"""Limits of a rigid disc's echo, both in closed form: short waves and long ones."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import j1

ComplexArray = npt.NDArray[np.complex128]


def kirchhoff_amplitude(ka: float, tilt_rad: npt.ArrayLike) -> ComplexArray:
    """Backscatter of a disc of radius 1 if each point reflected like an endless plane.

    On axis ``-i ka / 2``; right for ``ka`` much larger than 1 and small tilts.
    """
    tilt = np.asarray(tilt_rad, np.float64)
    argument = 2 * ka * np.sin(tilt)
    small = np.abs(argument) < 1e-6
    pattern = np.where(small, 0.5, j1(argument) / np.where(small, 1.0, argument))
    return np.asarray(-1j * ka * np.cos(tilt) * pattern)


def rayleigh_amplitude(ka: float, tilt_rad: npt.ArrayLike) -> ComplexArray:
    """Exact backscatter of a rigid disc of radius 1 for ``ka`` towards 0: an axial dipole.

    Bowman, Senior and Uslenghi, Electromagnetic and Acoustic Scattering by Simple Shapes, ch. 14.
    """
    return np.asarray(-2 * ka**2 / (3 * np.pi) * np.cos(tilt_rad) ** 2, np.complex128)
