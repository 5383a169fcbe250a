"""The sigma-delta loop: audio of 32 microphones to PDM words."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

LANES = 32  # microphones
INTERPOLATION_TAPS = 8  # of one PDM phase: the audio filter's taps over the decimation
_PAIRS = INTERPOLATION_TAPS // 2


# No fastmath, and no fused multiplication: a bit must not depend on the processor.
@numba.njit(cache=True, nogil=True)
def sigma_delta(
    audio: npt.NDArray[np.float32],
    even: npt.NDArray[np.float32],
    odd: npt.NDArray[np.float32],
    forward: npt.NDArray[np.float32],
    feedback: npt.NDArray[np.float32],
    state: npt.NDArray[np.float32],
    dither: npt.NDArray[np.float32],
    words: npt.NDArray[np.uint32],
) -> None:
    """Interpolate audio and turn it into PDM bits, error feedback in transposed form.

    Written so that the compiler takes the microphones as lanes: a fixed number of them, no branch,
    the word gathered where its bits are decided. The interpolation filter is symmetric: phase p and
    the mirrored one share their products.

    audio : float32, shape (num_samples + INTERPOLATION_TAPS - 1, LANES), padded in front
    even, odd : float32, shape (num_phases / 2, 4), over sums and differences of mirrored samples
    forward, feedback : float32, shape (4,); w[n] = forward . e[n-i] - feedback . w[n-i]
    state : float32, shape (4, LANES), of the loop
    dither : float32, shape (any, LANES), added before the decision, over and over
    words : uint32, shape (num_samples * num_phases,), written
    """
    half = even.shape[0]
    num_phases = 2 * half
    f0, f1, f2, f3 = forward[0], forward[1], forward[2], forward[3]
    b0, b1, b2, b3 = feedback[0], feedback[1], feedback[2], feedback[3]
    one, limit, zero = np.float32(1), np.float32(1.5), np.float32(0)
    mirrored = np.empty((2 * _PAIRS, LANES), np.float32)
    y = np.empty((num_phases, LANES), np.float32)
    s = np.empty((4, LANES), np.float32)
    s[:] = state
    bits = np.empty(LANES, np.uint32)
    for m in range(LANES):
        bits[m] = np.uint32(1) << np.uint32(m)
    row = 0
    for sample in range(words.size // num_phases):
        near = audio[sample : sample + INTERPOLATION_TAPS]
        for m in range(LANES):
            for j in range(_PAIRS):
                mirrored[j, m] = near[j, m] + near[INTERPOLATION_TAPS - 1 - j, m]
                mirrored[_PAIRS + j, m] = near[j, m] - near[INTERPOLATION_TAPS - 1 - j, m]
        for p in range(half):
            e, o = even[p], odd[p]
            e0, e1, e2, e3, o0, o1, o2, o3 = e[0], e[1], e[2], e[3], o[0], o[1], o[2], o[3]
            q = mirrored
            for m in range(LANES):
                same = e0 * q[0, m] + e1 * q[1, m] + e2 * q[2, m] + e3 * q[3, m]
                other = o0 * q[4, m] + o1 * q[5, m] + o2 * q[6, m] + o3 * q[7, m]
                y[p, m] = same + other
                y[num_phases - 1 - p, m] = same - other
        for p in range(num_phases):
            word = np.uint32(0)
            for m in range(LANES):
                w = s[0, m]
                quantised = y[p, m] + w
                decided = quantised + dither[row, m]
                word |= bits[m] if decided >= zero else np.uint32(0)
                error = (one if decided >= zero else -one) - quantised
                # A real modulator's integrators clip: overload ends when the drive does.
                error = error if error > -limit else -limit
                error = error if error < limit else limit
                s[0, m] = s[1, m] + (f0 * error - b0 * w)
                s[1, m] = s[2, m] + (f1 * error - b1 * w)
                s[2, m] = s[3, m] + (f2 * error - b2 * w)
                s[3, m] = f3 * error - b3 * w
            words[sample * num_phases + p] = word
            row = row + 1 if row + 1 < dither.shape[0] else 0
    state[:] = s
