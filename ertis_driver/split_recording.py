"""A recording in files of bounded size."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ertis_driver.closing import Closing
from ertis_driver.errors import SettingsError
from ertis_driver.frame import PdmFrame
from ertis_driver.protocol import frame_bytes
from ertis_driver.recording_info import RecordingInfo
from ertis_driver.recording_writer import RecordingWriter

SLACK_BYTES = 65_536  # layout, schemas, a summary


class SplitRecording(Closing):
    """Writes as ``RecordingWriter`` does, into the next file when one is full.

    Each file is a recording by itself: ``hall_001.mcap``, ``hall_002.mcap``, ...

    Parameters
    ----------
    path
        ``hall.mcap`` for those.
    info
        Of each; ``part`` is counted.
    max_bytes
        Of each file; it is a little smaller.
    options
        As ``RecordingWriter`` has them.

    Raises
    ------
    SettingsError
        If a file would not hold two pings.
    RecordingError
        If a file exists or cannot be written.

    Attributes
    ----------
    paths : list of Path
        Files so far.
    pings_written : int
        In all of them.
    """

    def __init__(self, path: Path, info: RecordingInfo, max_bytes: int, **options: Any) -> None:
        self._ping_bytes = frame_bytes(info.num_words) + SLACK_BYTES
        if max_bytes < 2 * self._ping_bytes:
            raise SettingsError(
                f"files of {max_bytes} bytes, expected {2 * self._ping_bytes} at least: two pings"
            )
        self._path, self._info, self._max_bytes, self._options = path, info, max_bytes, options
        self.paths: list[Path] = []
        self.pings_written = 0
        self._closed_bytes = 0
        self._writer = self._next_writer()

    @property
    def size(self) -> int:
        """Bytes written so far, in all files."""
        return self._closed_bytes + self._writer.size

    def write(self, frame: PdmFrame, truth: dict[str, Any] | None = None) -> None:
        """Add a ping; as ``RecordingWriter.write``."""
        if self._writer.size + self._ping_bytes > self._max_bytes:
            self._writer.close()
            self._closed_bytes += self._writer.size
            self._writer = self._next_writer()
        self._writer.write(frame, truth)
        self.pings_written += 1

    def write_event(self, event: bytes, time_ns: int) -> None:
        """Add an event; as ``RecordingWriter.write_event``."""
        self._writer.write_event(event, time_ns)

    def write_picture(self, image: bytes, time_ns: int, kind: str = "png") -> None:
        """Add a picture; as ``RecordingWriter.write_picture``."""
        self._writer.write_picture(image, time_ns, kind)

    def write_log(self, level: str, message: str, time_ns: int, name: str = "ertis") -> None:
        """Add a line of log; as ``RecordingWriter.write_log``."""
        self._writer.write_log(level, message, time_ns, name)

    def close(self) -> None:
        """Finish the last file. May be called twice."""
        self._writer.close()

    def _next_writer(self) -> RecordingWriter:
        part = len(self.paths) + 1
        path = self._path.with_name(f"{self._path.stem}_{part:03d}{self._path.suffix}")
        writer = RecordingWriter(path, dataclasses.replace(self._info, part=part), **self._options)
        self.paths.append(path)
        return writer
