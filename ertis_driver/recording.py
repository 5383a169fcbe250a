"""Recordings: MCAP in and out, headerless words in."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from ertis_driver.closing import Closing
from ertis_driver.errors import RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.mcap_reader import MAGIC, read_info, read_pings
from ertis_driver.protocol import encode_frame
from ertis_driver.raw_recording import raw_info, raw_pings
from ertis_driver.recording_info import CREATED_BY, RecordedPing, RecordingInfo, to_strings

__all__ = [
    "RecordedPing",
    "Recording",
    "RecordingInfo",
    "RecordingWriter",
    "open_recording",
    "read_recording",
]

FRAME_LAYOUT = b"""\
A ping as the eRTIS sends it; every field is a little-endian uint32:
header 0x51534E12, ping index, N PDM words, footer 0x2F418672.
Bit m of word n is microphone m's PDM bit, n / pdm_rate_hz s after the start.
"""
PING_SCHEMA = {
    "type": "object",
    "properties": {
        "ping_index": {"type": "integer", "minimum": 0},
        "active": {"type": "boolean", "description": "a chirp was emitted"},
        "time_uncertainty_ns": {"type": "integer", "minimum": 0},
        "clock_step_ns": {"type": "integer", "description": "host clock set since the last ping"},
        "temperature_c": {"type": ["number", "null"]},
    },
    "required": ["ping_index", "active", "time_uncertainty_ns", "temperature_c"],
}


class RecordingWriter(Closing):
    """Writes an MCAP recording, ping by ping; what is written survives the writer's death.

    Parameters
    ----------
    path
        A new file: nothing is overwritten.
    info
        Who makes the recording, and how.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written.
    """

    def __init__(self, path: str | Path, info: RecordingInfo) -> None:
        self.path = Path(path)
        self.info = info
        self.pings_written = 0
        try:
            self._file = self.path.open("xb")
        except FileExistsError as error:
            raise RecordingError(f"{path} exists: name another file, or remove it") from error
        except OSError as error:
            raise self._failed(error) from error
        self._writer = Writer(
            self._file,
            # Reached by each frame and by nothing less: a chunk a ping, so that a torn file loses
            # only its last one.
            chunk_size=4 * info.num_words,
            compression=CompressionType.NONE,  # PDM does not compress
            enable_crcs=True,
            enable_data_crcs=True,
        )
        try:
            self._writer.start(profile="", library=CREATED_BY)
            self._writer.add_metadata("ertis", to_strings(info))
            self._channels = self._register()
            self._file.flush()
        except OSError as error:
            self._file.close()
            raise self._failed(error) from error

    def write(
        self,
        frame: PdmFrame,
        truth: dict[str, Any] | None = None,
        *,
        temperature_c: float | None = None,
    ) -> None:
        """Add one ping and flush it.

        Parameters
        ----------
        frame
            Of ``info.num_words`` words.
        truth
            What stood where: anything that JSON can say.
        temperature_c
            Air temperature at this ping, degrees Celsius; ``info.temperature_c`` if not given.

        Raises
        ------
        RecordingError
            If the frame or its truth does not fit, or the disk does not take it.
        """
        if frame.words.shape != (self.info.num_words,):
            raise RecordingError(
                f"{self.path}: frame of shape {frame.words.shape}, expected "
                f"({self.info.num_words},) as the recording began"
            )
        if frame.pdm_rate_hz != self.info.pdm_rate_hz:
            raise RecordingError(
                f"{self.path}: frame at {frame.pdm_rate_hz} Hz, expected {self.info.pdm_rate_hz} "
                "as the recording began"
            )
        ping = {
            "ping_index": int(frame.ping_index),
            "active": bool(frame.active),
            "time_uncertainty_ns": int(frame.time_uncertainty_ns),
            "clock_step_ns": int(frame.clock_step_ns),
            "temperature_c": self.info.temperature_c if temperature_c is None else temperature_c,
        }
        messages = {"ping": self._json(ping)}
        if truth is not None:
            messages["truth"] = self._json(truth)
        messages["pdm"] = encode_frame(frame.ping_index, frame.words)
        try:
            for topic, data in messages.items():
                self._writer.add_message(
                    self._channels[topic],
                    log_time=frame.ping_time_ns,
                    publish_time=frame.ping_time_ns,
                    sequence=self.pings_written,
                    data=data,
                )
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error
        self.pings_written += 1

    def close(self) -> None:
        """Finish the file. May be called twice.

        Raises
        ------
        RecordingError
            If the disk does not take the end.
        """
        if self._file.closed:
            return
        try:
            try:
                self._writer.finish()  # type: ignore[no-untyped-call]
            finally:
                self._file.close()
        except OSError as error:
            raise self._failed(error) from error

    def _register(self) -> dict[str, int]:
        add_schema, add_channel = self._writer.register_schema, self._writer.register_channel
        frame_schema = add_schema("ertis.Frame", "text", FRAME_LAYOUT)
        ping_schema = add_schema("ertis.Ping", "jsonschema", self._json(PING_SCHEMA))
        truth_schema = add_schema("ertis.Truth", "jsonschema", self._json({"type": "object"}))
        return {
            "pdm": add_channel("pdm", "ertis-frame", frame_schema),
            "ping": add_channel("ping", "json", ping_schema),
            "truth": add_channel("truth", "json", truth_schema),
        }

    def _json(self, value: dict[str, Any]) -> bytes:
        try:
            return json.dumps(value, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{self.path}: this is not JSON: {error}") from error

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(f"cannot write {self.path}: {error.strerror}")


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
