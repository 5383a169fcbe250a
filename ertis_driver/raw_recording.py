"""Headerless recordings: nothing but uint32 PDM words, little-endian (``.bin``)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ertis_driver.device import MAX_NUM_WORDS, WORDS_STEP
from ertis_driver.errors import RecordingError
from ertis_driver.frame import DEFAULT_NUM_WORDS, PdmFrame
from ertis_driver.recording_info import RecordedPing, RecordingInfo

PERIOD_NS = 100_000_000  # nominal 10 Hz from the epoch on: such a file holds no times


def raw_info(path: Path, size: int) -> RecordingInfo:
    """Judge a headerless file by its size in bytes, all that it says about itself.

    Raises
    ------
    RecordingError
        If no number of pings has that size.
    """
    num_words = size // 4
    if size == 0 or size % (4 * WORDS_STEP):
        raise RecordingError(
            f"{path} is no recording: {size} bytes without MCAP's magic bytes, and raw PDM words "
            f"come in multiples of {4 * WORDS_STEP} bytes; name another file"
        )
    if num_words % DEFAULT_NUM_WORDS == 0:
        num_words = DEFAULT_NUM_WORDS
    if num_words > MAX_NUM_WORDS:
        raise RecordingError(
            f"{path} is no recording: {num_words} raw PDM words, expected at most {MAX_NUM_WORDS} "
            f"or a multiple of {DEFAULT_NUM_WORDS}; name another file"
        )
    return RecordingInfo(source="replay", chirp=None, num_words=num_words)


def raw_pings(path: Path, num_words: int) -> Iterator[RecordedPing]:
    """Yield the pings of a headerless file, ``num_words`` words each, taken as active ones.

    Raises
    ------
    RecordingError
        If it cannot be read, or has become shorter meanwhile.
    """
    index = 0
    try:
        with path.open("rb") as file:
            while data := file.read(4 * num_words):
                if len(data) != 4 * num_words:
                    raise RecordingError(f"{path} ends in the middle of ping {index}")
                words = np.frombuffer(data, dtype="<u4").astype(np.uint32)
                yield RecordedPing(PdmFrame(words, index, index * PERIOD_NS))
                index += 1
    except OSError as error:
        raise RecordingError(f"cannot read {path} after {index} pings: {error.strerror}") from error
