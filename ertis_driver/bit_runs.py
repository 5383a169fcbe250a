"""What PDM bits alone tell: stuck lines, runs of equal bits, two lines that are one.

A sigma-delta modulator never rests: in silence its longest run is 5 words. Runs grow with level,
to 11 words at 0.6 of full scale, 16 at 0.8 to 0.9, more than 20 where it clips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_driver.frame import NUM_MICS

# 57 us: word 0 is garbage, and a modulator takes some 200 words to settle. The direct path, 33 mm
# away at the nearest microphone, is not there before word 430.
STARTUP_WORDS = 256
# 3.6 us: beyond the stable range of a 4th-order modulator (-1 to -3 dBFS).
SATURATED_RUN_WORDS = 16
# 57 us: half a period of 8.8 kHz. Not even a signal far beyond full scale makes such a run.
INTERRUPTED_RUN_WORDS = 256
_CHUNK_WORDS = 32_768  # 128 kB a buffer: stays in the cache
_BLOCK = 8  # changes; half a run less one, so that every run holds an aligned block of them
_ALL_MICS = np.uint32(0xFFFF_FFFF)
_COMPARED_WORDS = 256  # two noisy microphones never agree on so many bits

Words = npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class LongRuns:
    """Runs of ``SATURATED_RUN_WORDS`` or more equal bits, by microphone.

    total_words : list of int, length 32
        Their lengths, added up; 0 for interrupted ones, whose runs are no sound.
    end_word : list of int, length 32
        Position just after the last one; 0 if there is none.
    interrupted : int
        Bit mask of the microphones with a run of ``INTERRUPTED_RUN_WORDS`` or more.
    """

    total_words: list[int]
    end_word: list[int]
    interrupted: int


def stuck_mics(words: Words) -> int:
    """Bit mask of the microphones whose bit never changes after start-up.

    Parameters
    ----------
    words : uint32, shape (num_words,)
    """
    settled = words[STARTUP_WORDS:]
    high = int(np.bitwise_and.reduce(settled))
    low = ~int(np.bitwise_or.reduce(settled)) & int(_ALL_MICS)
    return high | low


def long_runs(words: Words, ignore: int = 0) -> LongRuns:
    """Runs of equal bits that no sound within full scale makes.

    Parameters
    ----------
    words : uint32, shape (num_words,)
    ignore
        Bit mask of microphones to leave out, for example those that are stuck anyway.
    """
    mask = ~np.uint32(ignore)
    blocks = _quiet_blocks(words, mask)
    if blocks.size == 0:
        return LongRuns([0] * NUM_MICS, [0] * NUM_MICS, 0)
    # A chirp's runs stand close together: the exact search is short.
    first = max(int(blocks[0]) - SATURATED_RUN_WORDS, STARTUP_WORDS)
    part = words[first : int(blocks[-1]) + _BLOCK + 2 * SATURATED_RUN_WORDS]
    hits = _joined(~(part[1:] ^ part[:-1]) & mask, (1, 2, 4, 7))  # 15 equal pairs: 16 words
    # 15 + 240 equal pairs: 256 words.
    interrupted = np.bitwise_or.reduce(_joined(hits, (15, 30, 60, 120, 15)))
    hits &= ~interrupted
    at = np.flatnonzero(hits)
    if at.size == 0:
        return LongRuns([0] * NUM_MICS, [0] * NUM_MICS, int(interrupted))
    inside = _bits(hits[at])
    starting = _bits(hits[at] & ~np.where(at > 0, hits[at - 1], np.uint32(0)))
    # A run of n + 15 words is n hits in a row.
    total = inside.sum(axis=0) + (SATURATED_RUN_WORDS - 1) * starting.sum(axis=0)
    last = at[at.size - 1 - inside[::-1].argmax(axis=0)] + first + SATURATED_RUN_WORDS
    return LongRuns(total.tolist(), np.where(total > 0, last, 0).tolist(), int(interrupted))


def _joined(hits: Words, steps: tuple[int, ...]) -> Words:
    """Where ``hits`` go on for the sum of ``steps`` more; may be empty."""
    for step in steps:
        hits = hits[:-step] & hits[step:]
    return hits


def _bits(words: Words) -> npt.NDArray[np.uint8]:
    """Shape (num_words, 32), 0 or 1."""
    octets = words.astype("<u4", copy=False).view(np.uint8).reshape(-1, 4)
    return np.unpackbits(octets, axis=1, bitorder="little")


def _quiet_blocks(words: Words, mask: np.uint32) -> npt.NDArray[np.intp]:
    """Positions of blocks in which some microphone's bit never changes: any long run holds one."""
    changes = np.empty(_CHUNK_WORDS, np.uint32)
    blocks = []
    # Aligned blocks of 8 changes; the last, incomplete one cannot hold half a run.
    end = STARTUP_WORDS + (words.size - 1 - STARTUP_WORDS) // _BLOCK * _BLOCK
    for start in range(STARTUP_WORDS, end, _CHUNK_WORDS):
        stop = min(start + _CHUNK_WORDS, end)
        part = np.bitwise_xor(
            words[start + 1 : stop + 1], words[start:stop], out=changes[: stop - start]
        )
        pairs = part.view(np.uint64)
        halves = ((pairs[0::4] | pairs[1::4]) | (pairs[2::4] | pairs[3::4])).view(np.uint32)
        quiet = np.flatnonzero((halves[0::2] | halves[1::2] | ~mask) != _ALL_MICS)
        blocks.append(quiet * _BLOCK + start)
    return np.concatenate(blocks) if blocks else np.empty(0, np.intp)


def twin_mics(words: Words) -> dict[int, int]:
    """Microphones that carry exactly the bits of another one, as two on one data line do.

    Parameters
    ----------
    words : uint32, shape (num_words,)

    Returns
    -------
    dict of microphone row -> the first other row with the same bits
    """
    lines = np.packbits(_bits(words[-_COMPARED_WORDS:]).T, axis=1)
    size, octets = lines.shape[1], lines.tobytes()
    rows: dict[bytes, list[int]] = {}
    for mic in range(NUM_MICS):
        rows.setdefault(octets[mic * size : (mic + 1) * size], []).append(mic)
    return {
        mic: next(other for other in same if other != mic)
        for same in rows.values()
        if len(same) > 1
        for mic in same
    }
