"""Diffraction at a dish's rim, as a sharp rigid edge: what physical optics leaves out.

Keller's coefficient of a hard half plane, less the part that the surface integral has already
where it reaches the concave face (Ufimtsev's fringe wave). Time goes as e^{-iwt}.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_AZIMUTHS = 2 * np.pi * np.arange(72) / 72
_STRONGEST = 3.0  # Keller's coefficient is infinite where the edge joins a mirror


def rim_orders(half_opening_rad: float, tilt_rad: FloatArray) -> FloatArray:
    """Strength of the rim's echo, as a series over its azimuth.

    Parameters
    ----------
    half_opening_rad : float
        Between axis and rim, from the centre of the sphere.
    tilt_rad : shape (num_tilts,)
        0 looks into the dish, pi at its back.

    Returns
    -------
    float64, shape (num_tilts, 3)
        g_0, g_1, g_2 of ``g = g_0 + g_1 cos + g_2 cos 2``, to go with ``(-i)^p J_p``; scattering
        length over aperture radius. Ufimtsev, Fundamentals of the PTD, ch. 4 (half plane, hard).
    """
    tilt, around = np.asarray(tilt_rad)[:, None], _AZIMUTHS[None, :]
    sin_a, cos_a = np.sin(half_opening_rad), np.cos(half_opening_rad)
    # Of the direction: along the face away from the edge, off the concave face, along the edge.
    along = -np.sin(tilt) * np.cos(around) * cos_a - np.cos(tilt) * sin_a
    off = -np.sin(tilt) * np.cos(around) * sin_a + np.cos(tilt) * cos_a
    size = np.maximum(np.hypot(along, off), 1e-3)
    cos_phi, sin_phi = along / size, off / size
    front = tilt <= np.pi / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        keller = -(1 + 1 / cos_phi) / 2
        fringe = -(1 + cos_phi / (1 + sin_phi)) / 2
    g = np.where(front & (sin_phi > 0), fringe, keller)
    # Seen from behind, a point whose concave side it would be is hidden by the dish.
    g = np.where(~front & (sin_phi > 0), 0.0, np.clip(g, -_STRONGEST, _STRONGEST))
    return np.stack(
        [g.mean(axis=1), *(2 * (g * np.cos(p * around)).mean(axis=1) for p in (1, 2))], axis=1
    )
