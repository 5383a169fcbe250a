"""PDM words to 450 kHz audio: byte table, then a small banded matrix over overlapping blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_driver.audio_filter import LEAD, TAPS, UNITY, heard_of_bit
from ertis_driver.frame import DECIMATION, NUM_MICS
from ertis_driver.halfword import find_corrupt_bits

OUTPUTS_PER_BLOCK = 6
BLOCKS_PER_CHUNK = 64  # 0.5 MB of expanded bits: stays in the L2 cache, which is what makes it fast
_HOP = OUTPUTS_PER_BLOCK * DECIMATION
_BLOCK_ROWS = _HOP - DECIMATION + TAPS.size
_CHUNK_ROWS = BLOCKS_PER_CHUNK * _HOP


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


def _byte_table() -> npt.NDArray[np.float32]:
    bits = (np.arange(256)[:, None] >> np.arange(8)) & 1
    return np.asarray((2 * bits - 1).astype(np.float32))


def _banded_matrix() -> npt.NDArray[np.float32]:
    matrix = np.zeros((OUTPUTS_PER_BLOCK, _BLOCK_ROWS), np.float32)
    for output in range(OUTPUTS_PER_BLOCK):
        # A power of two scales exactly.
        matrix[output, output * DECIMATION : output * DECIMATION + TAPS.size] = TAPS / UNITY
    return matrix


class PdmDecoder:
    """PDM words to audio, with buffers kept from call to call. Not for use by two threads at once.

    The first word is start-up garbage and is treated as silence, as is everything before it.
    Corrupt half-words are mended (see ``halfword``).
    """

    def __init__(self) -> None:
        self._table = _byte_table()
        self._matrix = _banded_matrix()
        rows = _CHUNK_ROWS + _BLOCK_ROWS - _HOP
        self._bits = np.zeros((rows, NUM_MICS), np.float32)
        self._octets = np.empty((rows, 4), np.intp)
        stride = self._bits.strides
        self._blocks = np.lib.stride_tricks.as_strided(
            self._bits,
            (BLOCKS_PER_CHUNK, _BLOCK_ROWS, NUM_MICS),
            (_HOP * stride[0], stride[0], stride[1]),
            writeable=False,
        )
        self._sums = np.empty((BLOCKS_PER_CHUNK, OUTPUTS_PER_BLOCK, NUM_MICS), np.float32)

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
        corrupt = find_corrupt_bits(words, audio)
        for position, bits in corrupt.items():
            self._mend(audio, words[position], position, bits)
        return DecodedAudio(audio, len(corrupt))

    def _decimate(self, words: npt.NDArray[np.uint32], audio: npt.NDArray[np.float32]) -> None:
        num_out = audio.shape[1]
        octets = words.view(np.uint8).reshape(words.size, 4)
        for first_out in range(0, num_out, BLOCKS_PER_CHUNK * OUTPUTS_PER_BLOCK):
            self._expand(octets, first_out * DECIMATION - LEAD)
            np.matmul(self._matrix, self._blocks, out=self._sums)
            flat = self._sums.reshape(-1, NUM_MICS)[: num_out - first_out]
            audio[:, first_out : first_out + len(flat)] = flat.T

    def _expand(self, octets: npt.NDArray[np.uint8], first: int) -> None:
        """Fill the bit buffer with words ``first ...``; silence where there are none."""
        rows = self._bits
        start, stop = max(first, 0), min(first + len(rows), len(octets))
        a, b = start - first, max(stop - first, 0)
        rows[:a] = 0
        rows[b:] = 0
        if b > a:
            # What take would do itself, in fresh memory.
            index = self._octets[: b - a]
            index[...] = octets[start:stop]
            self._table.take(index, 0, rows[a:b].reshape(b - a, 4, 8), "wrap")
        if start == 0:
            rows[a] = 0  # word 0

    @staticmethod
    def _mend(
        audio: npt.NDArray[np.float32], word: np.uint32, position: int, bits: list[int]
    ) -> None:
        """Turn the wrong bits of one word over, exactly, in the audio they went into."""
        near, response = heard_of_bit(position, audio.shape[1])
        signs = np.where((word >> np.array(bits, np.uint32)) & 1, np.float32(2), np.float32(-2))
        audio[bits, near] -= signs[:, None] * response


def whole_samples(words: npt.NDArray[np.uint32]) -> npt.NDArray[np.uint32]:
    """The words that make whole audio samples: 32768, the firmware's step, is no multiple of 10."""
    return words[: words.size - words.size % DECIMATION]
