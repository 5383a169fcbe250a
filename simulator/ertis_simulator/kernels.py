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
                for tap in range(KERNEL_TAPS):
                    trains[mic, basis, first + tap] += weight * table[row, tap]


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

    audio : float32, shape (num_samples + taps - 1, 32), padded in front
    phases : float32, shape (10, taps), the interpolation filter
    forward, feedback : float32, shape (4,); w[n] = forward . e[n-i] - feedback . w[n-i]
    state : float32, shape (8, 32): four past errors, four past w
    dither : float32, shape (any, 32), added before the decision, over and over
    words : uint32, shape (num_samples * 10,), written
    """
    num_phases, taps = phases.shape
    lanes = audio.shape[1]
    drive = np.empty(lanes, np.float32)
    row = 0
    for sample in range(words.size // num_phases):
        for phase in range(num_phases):
            for m in range(lanes):
                drive[m] = np.float32(0)
            for tap in range(taps):
                gain = phases[phase, tap]
                for m in range(lanes):
                    drive[m] += gain * audio[sample + tap, m]
            word = np.uint32(0)
            for m in range(lanes):
                w = (
                    forward[0] * state[0, m]
                    + forward[1] * state[1, m]
                    + forward[2] * state[2, m]
                    + forward[3] * state[3, m]
                    - feedback[0] * state[4, m]
                    - feedback[1] * state[5, m]
                    - feedback[2] * state[6, m]
                    - feedback[3] * state[7, m]
                )
                y = drive[m] + w
                bit = y + dither[row, m] >= np.float32(0)
                error = (np.float32(1) if bit else np.float32(-1)) - y
                # A real modulator's integrators clip: overload ends when the drive does.
                error = min(max(error, np.float32(-1.5)), np.float32(1.5))
                state[3, m] = state[2, m]
                state[2, m] = state[1, m]
                state[1, m] = state[0, m]
                state[0, m] = error
                state[7, m] = state[6, m]
                state[6, m] = state[5, m]
                state[5, m] = state[4, m]
                state[4, m] = w
                word |= np.uint32(bit) << np.uint32(m)
            words[sample * num_phases + phase] = word
            row = row + 1 if row + 1 < dither.shape[0] else 0
