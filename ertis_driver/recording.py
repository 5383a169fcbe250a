"""Recordings: MCAP in and out, headerless words in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ertis_driver.errors import RecordingError
from ertis_driver.mcap_format import MAGIC
from ertis_driver.mcap_reader import read_info, read_pings
from ertis_driver.raw_recording import raw_info, raw_pings
from ertis_driver.recording_info import RecordedPing, RecordingInfo
from ertis_driver.recording_writer import RecordingWriter

__all__ = [
    "RecordedPing",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "open_recording",
    "read_recording",
]


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording, read from its beginning each time it is iterated; holds no file open.

    Iterating raises ``RecordingError`` where the file is cut off or damaged, after the pings
    before that.
    """

    path: Path
    info: RecordingInfo
    _pings: Callable[[], Iterator[RecordedPing]]

    def __iter__(self) -> Iterator[RecordedPing]:
        """Yield the pings in order, one in memory at a time."""
        return self._pings()


def read_recording(path: str | Path) -> Recording:
    """Open an MCAP recording.

    Raises
    ------
    RecordingError
        If it is no recording of ours.
    """
    path = Path(path)
    info = read_info(path)
    return Recording(path, info, lambda: read_pings(path, info))


def open_recording(path: str | Path) -> Recording:
    """Open an MCAP recording or headerless PDM words, whichever its first bytes say.

    Headerless: several pings of 163840 words, or one of any multiple of 32768 words.

    Raises
    ------
    RecordingError
        If it is neither.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            first = file.read(len(MAGIC))
            size = path.stat().st_size
    except FileNotFoundError as error:
        raise RecordingError(f"no recording {path}: check its name") from error
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error
    if first == MAGIC or path.suffix == ".mcap":
        return read_recording(path)
    info = raw_info(path, size)
    return Recording(path, info, lambda: raw_pings(path, info.num_words))
