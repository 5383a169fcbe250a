"""Corrupt half-words: the high half of a word carries the low half of the next one.

Seen in real recordings, a few a frame; each makes a broadband click on microphones 16-31. Equal
halves also happen by chance, so the click itself must confirm it: the response of single bits,
fitted to the audio above the chirp's band, stands out on microphones 16-31 only.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_driver.audio_filter import RESPONSE_REACH, RESPONSES
from ertis_driver.frame import DECIMATION, NUM_MICS

_HALF = NUM_MICS // 2
# Fourth difference: 3 % of a 60 kHz tone is left, but most of a click, which reaches 225 kHz.
_HIGH_PASS = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
_ENERGY_RATIO = 4.0  # clicks over the untouched microphones; measured clicks exceed 20
# Chance makes 2 or 3 of a frame's 163840, corruption has made 7. Hundreds are stuck bits, which
# no mending helps.
_MAX_CANDIDATES = 256


def _toeplitz() -> npt.NDArray[np.float64]:
    """The high-pass as a matrix, from a click's samples to those without its edges' influence."""
    length = 2 * RESPONSE_REACH
    matrix = np.zeros((length, length - _HIGH_PASS.size + 1))
    for column in range(matrix.shape[1]):
        matrix[column : column + _HIGH_PASS.size, column] = _HIGH_PASS
    return matrix


def _templates() -> npt.NDArray[np.float32]:
    """For each phase of a word in its audio sample: dotted with the audio there, bits' amplitude.

    The least-squares fit of the high-passed response to the high-passed audio; float32, shape
    (10, 16).
    """
    high_pass = _toeplitz()
    rows = [high_pass @ passed / (passed @ passed) for passed in RESPONSES @ high_pass]
    return np.array(rows, np.float32)


_TEMPLATES = _templates()


def find_corrupt_bits(
    words: npt.NDArray[np.uint32], audio: npt.NDArray[np.float32]
) -> dict[int, list[int]]:
    """Which bits of which words are wrong.

    Parameters
    ----------
    words : uint32, shape (num_words,)
    audio : float32, shape (32, num_words // 10)
        The same frame, decimated.

    Returns
    -------
    dict of word position -> microphones (16 to 31) whose bit there must be turned over
        Empty if equal halves are so many that they must have another cause.
    """
    halves = words.view("<u2")  # low, high, low, high ...
    equal = np.flatnonzero(halves[1:-1] == halves[2:])
    positions = equal[equal % 2 == 0] // 2
    centres = positions // DECIMATION
    inside = (centres >= RESPONSE_REACH) & (centres < audio.shape[1] - RESPONSE_REACH)
    positions, centres = positions[inside], centres[inside]
    if not 0 < positions.size <= _MAX_CANDIDATES:
        return {}
    windows = np.lib.stride_tricks.sliding_window_view(audio, 2 * RESPONSE_REACH, axis=1)
    heard = windows[:, centres - RESPONSE_REACH]
    # In bits: +-2 where one is wrong.
    amplitude = np.einsum("mcs,cs->cm", heard, _TEMPLATES[positions % DECIMATION])
    energy = amplitude**2
    clicks = energy[:, _HALF:].sum(axis=1) >= _ENERGY_RATIO * np.maximum(
        energy[:, :_HALF].sum(axis=1), 1.0
    )
    mics = np.arange(_HALF, NUM_MICS)
    signs = np.where((words[positions, None] >> mics.astype(np.uint32)) & 1, 1.0, -1.0)
    wrong = (amplitude[:, _HALF:] * signs > 1.0) & clicks[:, None]
    return {
        int(positions[row]): mics[wrong[row]].tolist() for row in np.flatnonzero(wrong.any(axis=1))
    }
