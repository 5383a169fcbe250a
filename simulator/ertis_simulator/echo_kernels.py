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
NUM_POLYNOMIALS = 12  # place_echoes has each of them written out
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
            row = table[int((delay[echo, mic] - whole) * _FRACTIONS + 0.5)]
            # Written out, so that a tap's sum stays in a register; always from left to right.
            c = coefficients[echo]
            c0, c2, c4, c6, c8, c10 = c[0], c[2], c[4], c[6], c[8], c[10]
            for n in range(TAPS):
                low = c0 * row[0, n] + c2 * row[2, n] + c4 * row[4, n]
                real[n] = low + c6 * row[6, n] + c8 * row[8, n] + c10 * row[10, n]
            c1, c3, c5, c7, c9, c11 = c[1], c[3], c[5], c[7], c[9], c[11]
            for n in range(TAPS):
                low = c1 * row[1, n] + c3 * row[3, n] + c5 * row[5, n]
                imag[n] = low + c7 * row[7, n] + c9 * row[9, n] + c11 * row[11, n]
            phase = -2 * np.pi * carrier * delay[echo, mic]
            cosine = np.float32(gain[echo, mic] * np.cos(phase))
            sine = np.float32(gain[echo, mic] * np.sin(phase))
            if first >= 0:
                out = parts[mic, 2 * first : 2 * (first + TAPS)]
                for n in range(TAPS):
                    out[2 * n] += cosine * real[n] - sine * imag[n]
                    out[2 * n + 1] += cosine * imag[n] + sine * real[n]
                continue
            for n in range(TAPS):
                at = (first + n) % train.shape[1]
                parts[mic, 2 * at] += cosine * real[n] - sine * imag[n]
                parts[mic, 2 * at + 1] += cosine * imag[n] + sine * real[n]
