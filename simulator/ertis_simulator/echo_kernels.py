"""Point echoes into impulse trains: a table of short filters, and the loop that places them.

An echo's spectrum is smooth: a short sum of Chebyshev polynomials over the band. So its impulse is
a short filter, the same sum of the polynomials' own impulses at its fractional delay.
"""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import numpy.typing as npt

HALF_BAND = 0.35  # of the train's rate, to either side of its carrier, is exact
NUM_POLYNOMIALS = 12
TAPS = 20
_FRACTIONS = 512
_QUADRATURE = 96
_SMALLEST = 1e-8  # of the filters' energy beyond the band counts: keeps them small there


@cache
def impulse_table() -> npt.NDArray[np.float32]:
    """Impulses of the polynomials, shape (_FRACTIONS + 1, NUM_POLYNOMIALS, TAPS).

    Row ``f`` is ``f / _FRACTIONS`` of a sample late. Of even polynomials the real part, of odd ones
    the imaginary; the other is nought. Least squares over the band.
    """
    x, weight = np.polynomial.legendre.leggauss(_QUADRATURE)
    turn = 2 * np.pi * HALF_BAND * x
    tap = np.arange(TAPS)
    gram = np.cos(np.subtract.outer(tap, tap)[..., None] * turn) @ weight
    fraction = np.arange(_FRACTIONS + 1) / _FRACTIONS
    late = tap - (TAPS // 2 - 1) - fraction[:, None]
    wanted = np.polynomial.chebyshev.chebvander(x, NUM_POLYNOMIALS - 1) * weight[:, None]
    phase = late[..., None] * turn
    right = np.empty((_FRACTIONS + 1, NUM_POLYNOMIALS, TAPS))
    right[:, 0::2] = np.swapaxes(np.cos(phase) @ wanted[:, 0::2], 1, 2)
    right[:, 1::2] = np.swapaxes(np.sin(phase) @ wanted[:, 1::2], 1, 2)
    inverse = np.linalg.inv(gram + _SMALLEST * np.eye(TAPS))
    return np.asarray((right @ inverse).astype(np.float32))


@numba.njit(cache=True, nogil=True)
def place_echoes(
    train: npt.NDArray[np.complex64],
    delay: npt.NDArray[np.float64],
    gain: npt.NDArray[np.float64],
    coefficients: npt.NDArray[np.float32],
    carrier: float,
    table: npt.NDArray[np.float32],
) -> None:
    """Add echoes to ``train``; what rings before its start goes to its end, as its FFT has it.

    train : complex64, shape (num_mics, length), around the carrier
    delay, gain : float64, shape (num_echoes, num_mics); delays in samples of the train
    coefficients : float32, shape (num_echoes, NUM_POLYNOMIALS)
    carrier : float, turns a sample
    table : :func:`impulse_table`
    """
    num_echoes, num_mics = delay.shape
    # Real and imaginary parts side by side: the compiler would multiply by complex taps otherwise.
    parts = train.view(np.float32)
    real, imag = np.empty(TAPS, np.float32), np.empty(TAPS, np.float32)
    for mic in range(num_mics):
        for echo in range(num_echoes):
            whole = int(np.floor(delay[echo, mic]))
            first = whole - TAPS // 2 + 1
            if gain[echo, mic] == 0 or whole < 0 or first + TAPS > train.shape[1]:
                continue
            rows = table[int((delay[echo, mic] - whole) * _FRACTIONS + 0.5)]
            for tap in range(TAPS):
                real[tap], imag[tap] = 0, 0
            for even in range(0, NUM_POLYNOMIALS, 2):
                of_even, of_odd = coefficients[echo, even], coefficients[echo, even + 1]
                for tap in range(TAPS):
                    real[tap] += of_even * rows[even, tap]
                    imag[tap] += of_odd * rows[even + 1, tap]
            phase = -2 * np.pi * carrier * delay[echo, mic]
            cosine = np.float32(gain[echo, mic] * np.cos(phase))
            sine = np.float32(gain[echo, mic] * np.sin(phase))
            for tap in range(min(-first, TAPS)):
                out = parts[mic, 2 * (first + tap + train.shape[1]) :]
                out[0] += cosine * real[tap] - sine * imag[tap]
                out[1] += cosine * imag[tap] + sine * real[tap]
            begin = max(-first, 0)
            out = parts[mic, 2 * (first + begin) : 2 * (first + TAPS)]
            for tap in range(begin, TAPS):
                out[2 * (tap - begin)] += cosine * real[tap] - sine * imag[tap]
                out[2 * (tap - begin) + 1] += cosine * imag[tap] + sine * real[tap]
