"""PDM words to 450 kHz audio: a table tells what ten bits add to the eight samples they are in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_driver.audio_filter import LEAD, TAPS, UNITY
from ertis_driver.digits import CUT, NUM_DIGITS, SILENT, DigitReader
from ertis_driver.frame import DECIMATION, NUM_MICS
from ertis_driver.halfword import mend

_SAMPLES = TAPS.size // DECIMATION  # that a digit is heard in
_FIRST_DIGIT = -(LEAD + 1) // DECIMATION  # of those that sample 0 is made of
_ONES = np.ones(_SAMPLES, np.float32)
_CHUNK_SAMPLES = 5464  # a third of a usual frame: what is made on the way fits the L2 cache


@dataclass(frozen=True, slots=True, eq=False)
class DecodedAudio:
    """Audio of one ping.

    audio : float32, shape (num_mics, num_samples)
        450 kHz, full scale 1; sample ``k`` is ``k / 450e3`` s after word 0.
    half_words_repaired : int
        Corrupt half-words found and mended.
    """

    audio: npt.NDArray[np.float32]
    half_words_repaired: int


def _digit_table() -> npt.NDArray[np.float32]:
    """What each digit adds to the samples that it is in, the earliest first; shape (n, 8)."""
    bits = 2 * ((np.arange(CUT)[:, None] >> np.arange(DECIMATION)) & 1) - 1
    taps = TAPS.reshape(_SAMPLES, DECIMATION).T
    table = np.zeros((NUM_DIGITS, _SAMPLES))
    table[:CUT] = bits @ taps
    table[CUT:SILENT] = bits[: SILENT - CUT, :-1] @ taps[:-1]
    return (table[:, ::-1] / UNITY).astype(np.float32)  # a power of two: exact


class PdmDecoder:
    """PDM words to audio, with buffers kept from call to call. Not for use by two threads at once.

    The first word is start-up garbage and is treated as silence, as is everything before it.
    Corrupt half-words are mended (see ``halfword``).
    """

    def __init__(self) -> None:
        steps = _CHUNK_SAMPLES // _SAMPLES + 1
        self._reader = DigitReader(steps, _SAMPLES)
        self._table = _digit_table()
        self._index = np.empty((2, _SAMPLES, steps), np.intp)
        # Every eighth digit adds to the next eight samples: side by side they are a row in time.
        self._added = np.empty((2, _SAMPLES, steps, _SAMPLES), np.float32)
        row, item = self._added.strides[1], self._added.itemsize
        # Each row begins a sample later than the one before.
        self._rows = np.lib.stride_tricks.as_strided(
            self._added.reshape(-1)[_SAMPLES - 1 :],
            (2, _SAMPLES, _CHUNK_SAMPLES),
            (_SAMPLES * row, row - item, item),
            writeable=False,
        )

    def decode(
        self, words: npt.NDArray[np.uint32], out: npt.NDArray[np.float32] | None = None
    ) -> DecodedAudio:
        """Decimate one frame by 10, mending what is known to be corrupt.

        Parameters
        ----------
        words : uint32, shape (num_words,)
            ``num_words`` a multiple of 10.
        out : float32, shape (32, num_words // 10)
            Written and returned instead of fresh memory, which costs a sixth of the decoding.

        Returns
        -------
        DecodedAudio
            ``num_words // 10`` samples a microphone; the same bits on every machine.

        Raises
        ------
        ValueError
            If ``words`` or ``out`` is of another type or shape.
        """
        if words.dtype != np.uint32 or words.ndim != 1 or words.size % DECIMATION:
            raise ValueError(
                f"PDM words: met {words.dtype} of shape {words.shape}, expected uint32 of shape "
                f"(n,) with n a multiple of {DECIMATION}"
            )
        shape = (NUM_MICS, words.size // DECIMATION)
        audio = np.empty(shape, np.float32) if out is None else out
        if audio.shape != shape or audio.dtype != np.float32:
            raise ValueError(
                f"out: met {audio.dtype} of shape {audio.shape}, expected float32 of shape {shape}"
            )
        self._decimate(words, audio)
        return DecodedAudio(audio, mend(words, audio))

    def _decimate(self, words: npt.NDArray[np.uint32], audio: npt.NDArray[np.float32]) -> None:
        num_samples = audio.shape[1]
        two_mics = audio.reshape(2, NUM_MICS // 2, num_samples).swapaxes(0, 1)
        for first in range(0, num_samples, _CHUNK_SAMPLES):
            chunk = two_mics[..., first : first + _CHUNK_SAMPLES]
            rows = self._rows[..., : chunk.shape[2]]
            digits = self._reader.read(words, first + _FIRST_DIGIT)
            for two_digits, two_sums in zip(digits, chunk, strict=True):
                # What take would do itself, in fresh memory.
                self._index[...] = two_digits
                self._table.take(self._index, 0, self._added, "wrap")
                np.matmul(_ONES, rows, out=two_sums)  # a sum in two passes rather than eight


def whole_samples(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    """The words that make whole audio samples: 32768, the firmware's step, is no multiple of 10."""
    return words[: words.size - words.size % DECIMATION]
