"""Scattering by a rigid sphere: the exact series that every other method must meet.

Bowman, Senior and Uslenghi, Electromagnetic and Acoustic Scattering by Simple Shapes, ch. 10.3:
the n-th partial wave of a sound-hard sphere scatters with ``j_n'(ka) / h_n'(ka)``.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import eval_legendre, spherical_jn, spherical_yn

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.integer]


def sphere_amplitude(ka: float, scattering_rad: npt.ArrayLike) -> ComplexArray:
    """Far-field amplitude of a rigid sphere of radius 1.

    Parameters
    ----------
    ka : float
        Wavenumber times the sphere's radius.
    scattering_rad : array_like
        Between the directions of travel of the incident and the scattered wave: pi is backwards.

    Returns
    -------
    complex128, shape of ``scattering_rad``
        Amplitude in sphere radii, phase from the sphere's centre.
    """
    orders, ratio = _partial_waves(ka)
    return np.asarray(1j / ka * _sum_orders((2 * orders + 1) * ratio, orders, scattering_rad))


def sphere_near_amplitude(
    ka: float, source_r: float, mic_r: float, between_rad: npt.ArrayLike
) -> ComplexArray:
    """The same for a point source and microphone at finite ranges (in sphere radii).

    Returns ``f`` of ``p = f exp(i k (r_s + r_m)) / (r_s r_m)``, for a source whose free field is
    ``exp(i k r) / r``; ``between_rad`` is the angle at the centre from source to microphone.
    """
    orders, ratio = _partial_waves(ka)
    outward = _hankel(orders, ka * source_r) * _hankel(orders, ka * mic_r)
    pressure = -1j * ka * _sum_orders((2 * orders + 1) * ratio * outward, orders, between_rad)
    return np.asarray(pressure * source_r * mic_r * np.exp(-1j * ka * (source_r + mic_r)))


def _partial_waves(ka: float) -> tuple[IntArray, ComplexArray]:
    # Past ka + 4 ka^(1/3) the terms fall faster than exponentially (Wiscombe, Appl. Opt. 19).
    orders = np.arange(int(ka + 6 * np.cbrt(ka) + 8))
    regular = spherical_jn(orders, ka, derivative=True)
    outward = regular + 1j * spherical_yn(orders, ka, derivative=True)
    return orders, np.asarray(regular / outward, np.complex128)


def _hankel(orders: IntArray, kr: float) -> ComplexArray:
    return np.asarray(spherical_jn(orders, kr) + 1j * spherical_yn(orders, kr))


def _sum_orders(terms: ComplexArray, orders: IntArray, angle_rad: npt.ArrayLike) -> ComplexArray:
    cosine = np.cos(np.asarray(angle_rad, np.float64))
    return np.asarray(eval_legendre(orders, cosine[..., None]) @ terms)
