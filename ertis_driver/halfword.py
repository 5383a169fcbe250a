"""Corrupt half-words: the high half of a word carries the low half of the next one.

Seen in real recordings, a few a frame; each makes a broadband click on microphones 16-31. Equal
halves also happen by chance, so the click itself must confirm it: the response of single bits,
fitted to the audio above the chirp's band, stands out on microphones 16-31 only.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_driver.audio_filter import RESPONSE_REACH, bit_response
from ertis_driver.frame import DECIMATION, NUM_MICS

_HALF = NUM_MICS // 2
# Fourth difference: 3 % of a 60 kHz tone is left, but most of a click, which reaches 225 kHz.
_HIGH_PASS_ORDER = 4
_ENERGY_RATIO = 4.0  # clicks over the untouched microphones; measured clicks exceed 20


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
    """
    differing = ((words[:-1] >> np.uint32(16)) ^ words[1:]) & np.uint32(0xFFFF)
    positions = np.flatnonzero(differing == 0)
    corrupt = {}
    for position in positions.tolist():
        wrong = _wrong_bits(int(words[position]), position, audio)
        if wrong:
            corrupt[position] = wrong
    return corrupt


def _wrong_bits(word: int, position: int, audio: npt.NDArray[np.float32]) -> list[int]:
    centre = position // DECIMATION
    if not RESPONSE_REACH <= centre < audio.shape[1] - RESPONSE_REACH:
        return []
    first, last = centre - RESPONSE_REACH, centre + RESPONSE_REACH
    template = np.diff(bit_response(position, np.arange(first, last)), _HIGH_PASS_ORDER)
    heard = np.diff(audio[:, first:last], _HIGH_PASS_ORDER)
    amplitude = heard @ template / (template @ template)  # in bits: +-2 where one is wrong
    energy = amplitude**2
    if energy[_HALF:].sum() < _ENERGY_RATIO * max(float(energy[:_HALF].sum()), 1.0):
        return []
    mics = np.arange(_HALF, NUM_MICS)
    signs = np.where((word >> mics) & 1, 1.0, -1.0)
    return [int(m) for m in mics[amplitude[_HALF:] * signs > 1.0]]
