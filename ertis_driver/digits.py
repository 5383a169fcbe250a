"""PDM words to digits: ten bits of one microphone, those of one audio sample, as one number.

A word holds a bit of each microphone, a digit bits of one microphone at ten times: the way from
one to the other is a transposition of bits, by exchanging ever wider fields between two words
(Warren, Hacker's Delight, 7-3), on whole arrays.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_driver.frame import DECIMATION, NUM_MICS

# Values that no ten bits have: a digit whose last bit is missing has CUT added, one of which there
# is nothing is SILENT.
CUT = 2**DECIMATION
SILENT = CUT + CUT // 2
NUM_DIGITS = SILENT + 1

Words = npt.NDArray[np.uint32]
# Arrays of no dimension: numbers would be made into such at each call.
_EXCHANGES = tuple(
    (np.array(width, np.uint32), np.array(mask, np.uint32))
    for width, mask in ((1, 0x5555_5555), (2, 0x3333_3333), (4, 0x0F0F_0F0F))
)
_LOW_OCTETS, _EIGHT = np.array(0x00FF_00FF, np.uint32), np.array(8, np.uint16)
_LAST_TWO = np.array(0x0300_0300, np.uint32)  # of the ten bits
_TO_LEFT = np.array([8, 6, 4, 2, 0], np.uint32)[:, None, None]
_TO_RIGHT = np.array([2, 4, 6], np.uint32)[:, None, None]


class DigitReader:
    """Reads digits, some of all microphones at a time.

    Digit ``n`` is of the words ``10 n + 1`` to ``10 n + 10``, the first of them its lowest bit.
    Word 0, which is start-up garbage, is in none.

    Parameters
    ----------
    num_steps, num_phases : int
        Digits come in so many interleaved rows (phases), each of so many (steps).
    """

    def __init__(self, num_steps: int, num_phases: int) -> None:
        self._shape = num_steps, num_phases
        count = num_steps * num_phases
        self._padded = np.empty(DECIMATION * count, np.uint32)
        self._words = np.empty((DECIMATION, count), np.uint32)
        self._digits = np.empty((NUM_MICS // 2, count), np.uint32)
        self._moved = np.empty((NUM_MICS // 4, 2, count), np.uint32)
        self._spare = self._moved.reshape(-1, count)[: DECIMATION // 2]

    def read(self, words: Words, first: int) -> npt.NDArray[np.uint16]:
        """Digits ``first`` and on; before and after the frame they are ``SILENT``.

        The last word of the frame's last digit is missing: that digit is a ``CUT`` one.

        Parameters
        ----------
        words : uint32, shape (num_words,)
            ``num_words`` a multiple of 10.

        Returns
        -------
        uint16, shape (16, 2, num_phases, num_steps)
            Of microphones ``m`` and ``m + 16``; digit ``first + p + num_phases * s`` of phase ``p``
            and step ``s``. Overwritten by the next call.
        """
        steps, phases = self._shape
        by_place = self._words.reshape(DECIMATION, phases, steps)
        by_place[...] = self._piece(words, first).reshape(steps, phases, -1).transpose(2, 1, 0)
        self._transpose_bits()
        digits = self._digits.view("<u2").reshape(-1, phases, steps, 2).transpose(0, 3, 1, 2)
        end = first + phases * steps
        cut = words.size // DECIMATION - 1
        if first <= cut < end:
            step, phase = divmod(cut - first, phases)
            digits[:, :, phase, step] |= CUT
        for start, stop in ((first, min(0, end)), (max(cut + 1, first), end)):
            if start < stop:
                step_of, phase_of = np.divmod(np.arange(start, stop) - first, phases)
                digits[:, :, phase_of, step_of] = SILENT
        return np.asarray(digits)

    def _piece(self, words: Words, first: int) -> Words:
        """The words of all digits from ``first`` on; 0 where there are none."""
        start = DECIMATION * first + 1
        stop = start + self._padded.size
        if start >= 0 and stop <= words.size:
            return words[start:stop]
        inside = words[max(start, 0) : max(stop, 0)]
        before = max(-start, 0)
        self._padded[:before] = 0
        self._padded[before : before + inside.size] = inside
        self._padded[before + inside.size :] = 0
        return self._padded

    def _transpose_bits(self) -> None:
        """Ten bits of each microphone into half a word: microphones m and m + 16 share one."""
        pairs = self._words.reshape(DECIMATION // 2, 2, -1)
        self._exchange(pairs[:, 0], pairs[:, 1], *_EXCHANGES[0])
        # Axes: which words, in which of two, and which microphones a word now tells of.
        fours = pairs[:4].reshape(2, 2, 2, -1)
        self._exchange(fours[:, 0], fours[:, 1], *_EXCHANGES[1])
        self._exchange(fours[0], fours[1], *_EXCHANGES[2])
        eights, low, high = self._words[:8], self._digits[:8], self._digits[8:]
        np.bitwise_and(eights, _LOW_OCTETS, out=low)
        np.right_shift(eights.view(np.uint16), _EIGHT, out=high.view(np.uint16))
        last_two, moved = pairs[4], self._moved
        np.left_shift(last_two, _TO_LEFT, out=moved[: len(_TO_LEFT)])
        np.right_shift(last_two, _TO_RIGHT, out=moved[len(_TO_LEFT) :])
        moved &= _LAST_TWO
        self._digits |= moved.reshape(self._digits.shape)

    def _exchange(self, a: Words, b: Words, width: Words, mask: Words) -> None:
        """Swap the upper fields of ``a`` with the lower ones of ``b``."""
        other = self._spare[: a.size // self._spare.shape[1]].reshape(a.shape)
        np.right_shift(a, width, out=other)
        other ^= b
        other &= mask
        b ^= other
        other <<= width
        a ^= other
