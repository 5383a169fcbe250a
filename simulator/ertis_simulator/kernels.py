"""Inner loops that numpy cannot vectorise: echoes, a dish's glints, the sigma-delta loop."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import numpy.typing as npt
from scipy.special import jv

KERNEL_TAPS = 20
_BESSEL_STEP = 0.05  # linear between: 3e-4
_HIGHEST_ORDER, _LONGEST_ARGUMENT = 6, 700.0


@cache
def bessel_table() -> npt.NDArray[np.float32]:
    """J_0 to J_6, shape (7, num_arguments), every ``_BESSEL_STEP``."""
    argument = np.arange(0.0, _LONGEST_ARGUMENT, _BESSEL_STEP)
    return np.array([jv(order, argument) for order in range(_HIGHEST_ORDER + 1)], np.float32)


@numba.njit(cache=True, nogil=True, fastmath=True)
def sum_glints(
    total: npt.NDArray[np.complex64],
    k_rad_m: npt.NDArray[np.float64],
    growth: npt.NDArray[np.float32],
    path_m: npt.NDArray[np.float64],
    reach_m: npt.NDArray[np.float64],
    strength: npt.NDArray[np.complex64],
    weights: npt.NDArray[np.complex64],
    circle_of_term: npt.NDArray[np.int64],
    order_of_term: npt.NDArray[np.int64],
    bessel: npt.NDArray[np.float32],
) -> None:
    """Add up a dish's glints, e^{-iwt}.

    total : complex64, shape (num_mics, num_k), added to
    k_rad_m : float64, shape (num_k,), evenly spaced
    growth : float32, shape (num_terms, num_k)
    path_m, reach_m : float64, shape (num_circles, num_mics)
    strength : complex64, shape (num_mics, num_terms, num_k)
    weights : complex64, shape (num_terms, num_mics)
    circle_of_term, order_of_term : int64, shape (num_terms,), terms of a circle side by side
    bessel : :func:`bessel_table`
    """
    last = bessel.shape[1] - 2
    num_k = k_rad_m.size
    k_step = k_rad_m[1] - k_rad_m[0] if num_k > 1 else 0.0
    wave = np.empty(num_k, np.complex64)
    place, share = np.empty(num_k, np.int64), np.empty(num_k, np.float32)
    for mic in range(total.shape[0]):
        circle = -1
        for term in range(circle_of_term.size):
            if circle_of_term[term] != circle:
                circle = circle_of_term[term]
                phase, step = k_rad_m[0] * path_m[circle, mic], k_step * path_m[circle, mic]
                turned = complex(np.cos(phase), np.sin(phase))
                turn = complex(np.cos(step), np.sin(step))
                for n in range(num_k):
                    wave[n] = turned
                    turned *= turn
                    spot = k_rad_m[n] * reach_m[circle, mic] / _BESSEL_STEP
                    place[n] = min(int(spot), last)
                    share[n] = min(spot - place[n], 1.0)
            row, weight = bessel[order_of_term[term]], weights[term, mic]
            for n in range(num_k):
                value = row[place[n]] + share[n] * (row[place[n] + 1] - row[place[n]])
                value *= growth[term, n]
                total[mic, n] += (weight * value) * (strength[mic, term, n] * wave[n])


@numba.njit(cache=True, nogil=True)
def place_echoes(
    trains: npt.NDArray[np.complex64],
    delays: npt.NDArray[np.float64],
    weights: npt.NDArray[np.complex64],
    table: npt.NDArray[np.float32],
) -> None:
    """Add band-limited impulses to ``trains``.

    trains : complex64, shape (num_mics, num_basis, length)
    delays : float64, shape (num_echoes, num_mics), in samples
    weights : complex64, shape (num_echoes, num_mics, num_basis)
    table : float32, shape (num_fractions + 1, KERNEL_TAPS), rows over the fractional delay
    """
    num_echoes, num_mics = delays.shape
    length = trains.shape[2]
    # Real and imaginary parts side by side: the compiler would multiply by complex taps otherwise.
    parts = trains.view(np.float32)
    fractions = table.shape[0] - 1
    for mic in range(num_mics):
        for echo in range(num_echoes):
            whole = int(np.floor(delays[echo, mic]))
            row = int((delays[echo, mic] - whole) * fractions + 0.5)
            first = whole - KERNEL_TAPS // 2 + 1
            if first < 0 or first + KERNEL_TAPS > length:
                continue
            for basis in range(trains.shape[1]):
                weight = weights[echo, mic, basis]
                out = parts[mic, basis, 2 * first : 2 * (first + KERNEL_TAPS)]
                for tap in range(KERNEL_TAPS):
                    out[2 * tap] += weight.real * table[row, tap]
                    out[2 * tap + 1] += weight.imag * table[row, tap]


LANES = 32  # microphones
INTERPOLATION_TAPS = 8  # of one PDM phase: the audio filter's taps over the decimation


@numba.njit(cache=True, nogil=True)
def sigma_delta(
    audio: npt.NDArray[np.float32],
    phases: npt.NDArray[np.float32],
    forward: npt.NDArray[np.float32],
    feedback: npt.NDArray[np.float32],
    state: npt.NDArray[np.float32],
    dither: npt.NDArray[np.float32],
    words: npt.NDArray[np.uint32],
) -> None:
    """Interpolate audio by ``len(phases)`` and turn it into PDM bits, error feedback form.

    Written so that the compiler takes the microphones eight at a time: a fixed number of lanes, the
    taps of the interpolation side by side, no branch. That is five times as fast as plain loops.

    audio : float32, shape (num_samples + INTERPOLATION_TAPS - 1, LANES), padded in front
    phases : float32, shape (10, INTERPOLATION_TAPS), the interpolation filter
    forward, feedback : float32, shape (4,); w[n] = forward . e[n-i] - feedback . w[n-i]
    state : float32, shape (8, LANES): four past errors, four past w
    dither : float32, shape (any, LANES), added before the decision, over and over
    words : uint32, shape (num_samples * 10,), written
    """
    num_phases = phases.shape[0]
    f0, f1, f2, f3 = forward[0], forward[1], forward[2], forward[3]
    b0, b1, b2, b3 = feedback[0], feedback[1], feedback[2], feedback[3]
    one, limit, zero = np.float32(1), np.float32(1.5), np.float32(0)
    y = np.empty(LANES, np.float32)
    s = np.empty((8, LANES), np.float32)
    s[:] = state
    row = 0
    for sample in range(words.size // num_phases):
        near = audio[sample : sample + INTERPOLATION_TAPS]
        a0, a1, a2, a3 = near[0], near[1], near[2], near[3]
        a4, a5, a6, a7 = near[4], near[5], near[6], near[7]
        for phase in range(num_phases):
            g = phases[phase]
            g0, g1, g2, g3, g4, g5, g6, g7 = g[0], g[1], g[2], g[3], g[4], g[5], g[6], g[7]
            for m in range(LANES):
                low = g0 * a0[m] + g1 * a1[m] + g2 * a2[m] + g3 * a3[m]
                y[m] = low + g4 * a4[m] + g5 * a5[m] + g6 * a6[m] + g7 * a7[m]
            for m in range(LANES):
                past = f0 * s[0, m] + f1 * s[1, m] + f2 * s[2, m] + f3 * s[3, m]
                w = past - b0 * s[4, m] - b1 * s[5, m] - b2 * s[6, m] - b3 * s[7, m]
                quantised = y[m] + w
                y[m] = quantised + dither[row, m]
                error = (one if y[m] >= zero else -one) - quantised
                # A real modulator's integrators clip: overload ends when the drive does.
                error = error if error > -limit else -limit
                error = error if error < limit else limit
                s[3, m], s[2, m], s[1, m], s[0, m] = s[2, m], s[1, m], s[0, m], error
                s[7, m], s[6, m], s[5, m], s[4, m] = s[6, m], s[5, m], s[4, m], w
            word = np.uint32(0)
            for m in range(LANES):
                word |= np.uint32(y[m] >= zero) << np.uint32(m)
            words[sample * num_phases + phase] = word
            row = row + 1 if row + 1 < dither.shape[0] else 0
    state[:] = s
