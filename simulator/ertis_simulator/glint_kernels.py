"""A dish's glints added up over frequency, for many microphones."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import jv

_BESSEL_STEP = 0.05  # linear between: 3e-4
_HIGHEST_ORDER, _LONGEST_ARGUMENT = 6, 700.0
_LANES = 8


@cache
def bessel_table() -> npt.NDArray[np.float32]:
    """J_0 to J_6, shape (7, num_arguments), every ``_BESSEL_STEP``."""
    argument = np.arange(0.0, _LONGEST_ARGUMENT, _BESSEL_STEP)
    return np.array([jv(order, argument) for order in range(_HIGHEST_ORDER + 1)], np.float32)


@numba.njit(cache=True, nogil=True)
def tabled_strengths(
    coefficients: npt.NDArray[np.complex64], scaled: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Chebyshev series at points, shape (2, num_tilts, num_terms, num_points): real and imaginary.

    coefficients : complex64, shape (num_tilts, num_terms, num_powers)
    scaled : float32, shape (num_points,), -1 to 1
    """
    tilts, terms, num_powers = coefficients.shape
    found = np.zeros((2, tilts, terms, scaled.size), np.float32)
    basis = np.ones((num_powers, scaled.size), np.float32)
    basis[1] = scaled
    for power in range(2, num_powers):
        basis[power] = 2 * scaled * basis[power - 1] - basis[power - 2]
    for tilt in range(tilts):
        for term in range(terms):
            real, imag = found[0, tilt, term], found[1, tilt, term]
            for power in range(num_powers):
                factor, each = coefficients[tilt, term, power], basis[power]
                a, b = factor.real, factor.imag
                for n in range(each.size):
                    real[n] += a * each[n]
                for n in range(each.size):
                    imag[n] += b * each[n]
    return found


@numba.njit(cache=True, nogil=True)
def _wave(
    first: float, step: float, cosine: npt.NDArray[np.float32], sine: npt.NDArray[np.float32]
) -> None:
    """Write e^{i (first + n step)}; lanes apart, so that the compiler takes them together."""
    size = cosine.size
    for n in range(min(_LANES, size)):
        cosine[n], sine[n] = np.cos(first + n * step), np.sin(first + n * step)
    c, s = np.float32(np.cos(_LANES * step)), np.float32(np.sin(_LANES * step))
    for n in range(_LANES, size):
        before_c, before_s = cosine[n - _LANES], sine[n - _LANES]
        cosine[n], sine[n] = before_c * c - before_s * s, before_c * s + before_s * c


@numba.njit(cache=True, nogil=True)
def sum_glints(
    total: npt.NDArray[np.complex64],
    k_rad_m: npt.NDArray[np.float64],
    growth: npt.NDArray[np.float32],
    path_m: npt.NDArray[np.float64],
    reach_m: npt.NDArray[np.float64],
    tabled: npt.NDArray[np.float32],
    row_of_mic: npt.NDArray[np.int64],
    share_of_mic: npt.NDArray[np.float32],
    steady: npt.NDArray[np.complex64],
    weights: npt.NDArray[np.complex64],
    circle_of_term: npt.NDArray[np.int64],
    order_of_term: npt.NDArray[np.int64],
    bessel: npt.NDArray[np.float32],
) -> None:
    """Add up a dish's glints, e^{-iwt}, and write them, e^{iwt}.

    total : complex64, shape (num_mics, num_k), written
    k_rad_m : float64, shape (num_k,), evenly spaced
    growth : float32, shape (num_terms, num_k)
    path_m, reach_m : float64, shape (num_circles, num_mics)
    tabled : float32, shape (2, num_rows, num_terms, num_k), strengths at tilts of a table
    row_of_mic, share_of_mic : shape (num_mics,), the row below, or -1 for none, and the share of
        the next one
    steady : complex64, shape (num_mics, num_terms), strength beside the tabled one, at any k
    weights : complex64, shape (num_terms, num_mics)
    circle_of_term, order_of_term : int64, shape (num_terms,), terms of a circle side by side
    bessel : :func:`bessel_table`
    """
    num_k = k_rad_m.size
    k_step = k_rad_m[1] - k_rad_m[0] if num_k > 1 else 0.0
    cosine, sine = np.empty(num_k, np.float32), np.empty(num_k, np.float32)
    place, part = np.empty(num_k, np.uint32), np.empty(num_k, np.float32)
    around_re, around_im = np.empty(num_k, np.float32), np.empty(num_k, np.float32)
    real, imag = np.empty(num_k, np.float32), np.empty(num_k, np.float32)
    value = np.empty(num_k, np.float32)
    last = np.float32(bessel.shape[1] - 2)
    for mic in range(total.shape[0]):
        real[:], imag[:] = 0, 0
        row, share, one = row_of_mic[mic], share_of_mic[mic], np.float32(1)
        if row < 0:
            row, share, one = 0, np.float32(0), np.float32(0)
        term = 0
        while term < circle_of_term.size:
            circle = circle_of_term[term]
            spot_first = np.float32(k_rad_m[0] * reach_m[circle, mic] / _BESSEL_STEP)
            spot_step = np.float32(k_step * reach_m[circle, mic] / _BESSEL_STEP)
            for n in range(num_k):
                spot = spot_first + np.float32(n) * spot_step
                spot = spot if spot < last else last
                place[n] = np.uint32(spot)
                part[n] = spot - np.float32(place[n])
            around_re[:], around_im[:] = 0, 0
            while term < circle_of_term.size and circle_of_term[term] == circle:
                values, grown = bessel[order_of_term[term]], growth[term]
                for n in range(num_k):
                    near, after = values[place[n]], values[place[n] + 1]
                    value[n] = (near + part[n] * (after - near)) * grown[n]
                fixed = weights[term, mic] * steady[mic, term]
                low, high = weights[term, mic] * (one - share), weights[term, mic] * share
                low_re, low_im = tabled[0, row, term], tabled[1, row, term]
                high_re, high_im = tabled[0, row + 1, term], tabled[1, row + 1, term]
                a, b, c, d, e = low.real, low.imag, high.real, high.imag, fixed.real
                # One sum a loop: the compiler checks what may overlap, and gives up at eight.
                for n in range(num_k):
                    strength = (a * low_re[n] - b * low_im[n]) + (c * high_re[n] - d * high_im[n])
                    around_re[n] += value[n] * (strength + e)
                e = fixed.imag
                for n in range(num_k):
                    strength = (a * low_im[n] + b * low_re[n]) + (c * high_im[n] + d * high_re[n])
                    around_im[n] += value[n] * (strength + e)
                term += 1
            first = k_rad_m[0] * path_m[circle, mic]
            _wave(first, k_step * path_m[circle, mic], cosine, sine)
            for n in range(num_k):
                real[n] += around_re[n] * cosine[n] - around_im[n] * sine[n]
                imag[n] += around_re[n] * sine[n] + around_im[n] * cosine[n]
        for n in range(num_k):
            total[mic, n] = complex(real[n], -imag[n])
