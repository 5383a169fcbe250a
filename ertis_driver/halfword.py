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


_TEMPLATES = _templates()[:, :, None]
_TWO_BITS = (2 * RESPONSES).astype(np.float32)  # from -1 to 1
_AROUND = np.arange(-RESPONSE_REACH, RESPONSE_REACH)
_HIGH_MICS = np.arange(_HALF, NUM_MICS, dtype=np.uint32)
_SIGNS = np.array([-1, 1], np.float32)  # of bits


def mend(words: npt.NDArray[np.uint32], audio: npt.NDArray[np.float32]) -> int:
    """Turn the wrong bits of a frame over in the audio they went into, exactly.

    Parameters
    ----------
    words : uint32, shape (num_words,)
    audio : float32, shape (32, num_words // 10)
        The same frame, decimated; changed in place.

    Returns
    -------
    int
        How many corrupt half-words were found.
    """
    positions, turned = find_corrupt_bits(words, audio)
    for position, one in zip(positions.tolist(), turned, strict=True):
        centre, place = divmod(position, DECIMATION)
        click = audio[_HALF:, centre - RESPONSE_REACH : centre + RESPONSE_REACH]
        click += one[:, None] * _TWO_BITS[place]
    return len(positions)


def find_corrupt_bits(
    words: npt.NDArray[np.uint32], audio: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    """Which bits of which words are wrong.

    Parameters
    ----------
    words, audio
        As of ``mend``.

    Returns
    -------
    positions : intp, shape (n,)
        Of words with wrong bits. None if equal halves are so many that they must have another
        cause.
    turned : float32, shape (n, 16)
        For microphones 16 to 31: 1 where a 0 must be a 1, -1 where a 1 must be a 0, else 0.
    """
    positions = _equal_halves(words)
    first, last = _bounds(audio.shape[1])
    positions = positions[(positions >= first) & (positions < last)]
    if positions.size > _MAX_CANDIDATES:
        positions = positions[:0]
    centres = positions // DECIMATION
    heard = audio[:, centres[:, None] + _AROUND].transpose(1, 0, 2)
    # In bits: +-2 where one is wrong.
    amplitude = (heard @ _TEMPLATES[positions - DECIMATION * centres])[:, :, 0]
    energy = np.add.reduce((amplitude**2).reshape(-1, 2, _HALF), axis=2)
    clicks = np.flatnonzero(energy[:, 1] >= _ENERGY_RATIO * np.maximum(energy[:, 0], 1.0))
    positions = positions[clicks]
    bits = words[positions, None] >> _HIGH_MICS & 1
    signs = _SIGNS[bits]
    wrong = amplitude[clicks, _HALF:] * signs > 1.0
    corrupt = wrong.any(axis=1)
    return positions[corrupt], (-signs * wrong)[corrupt]


def _equal_halves(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.intp]:
    """Positions of the words whose high half is the next one's low half."""
    halves = words.view("<u2")  # low, high, low, high ...
    equal = np.flatnonzero(halves[1:-1] == halves[2:])
    return np.asarray(equal[equal % 2 == 0] // 2)


def _bounds(num_samples: int) -> tuple[int, int]:
    """Words between which a click is not cut off by the frame's ends."""
    return RESPONSE_REACH * DECIMATION, (num_samples - RESPONSE_REACH) * DECIMATION
