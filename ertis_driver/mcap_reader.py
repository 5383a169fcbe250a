"""Reads the MCAP recordings that ``recording`` writes, and says in one line what is wrong."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from mcap.exceptions import McapError
from mcap.records import Channel, DataEnd, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from zstandard import ZstdError

from ertis_driver.errors import FrameCorrupt, RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.protocol import decode_frame
from ertis_driver.recording_info import RecordedPing, RecordingInfo, from_strings

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 1 << 28  # four times the longest frame: a length that lies must not take memory
TAIL = struct.Struct("<BQQQI8s")  # the footer record, then the closing magic

# All that damaged bytes have been seen to raise inside the mcap package.
DAMAGE = (
    McapError,
    ValueError,
    struct.error,
    OverflowError,
    MemoryError,
    LookupError,
    TypeError,
    AttributeError,
    EOFError,
    RuntimeError,  # lz4
    ZstdError,
)


def read_info(path: Path) -> RecordingInfo:
    """Read what the recording says about itself.

    Raises
    ------
    RecordingError
        If it is no recording of ours.
    """
    for record in _records(path):
        if isinstance(record, Metadata) and record.name == "ertis":
            try:
                return from_strings(record.metadata)
            except ValueError as error:
                raise RecordingError(f"{path}: {error}; record it again") from error
        if isinstance(record, Channel | Message | DataEnd):
            break
    raise RecordingError(f"{path} is an MCAP file, but no sonar recording: name another file")


def read_pings(path: Path, info: RecordingInfo) -> Iterator[RecordedPing]:
    """Yield the pings in order.

    Raises
    ------
    RecordingError
        Where the file is cut off or damaged, after the pings before that.
    """
    topics: dict[int, str] = {}
    parts: dict[str, Message] = {}
    num_pings = 0
    for record in _records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        if not isinstance(record, Message):
            continue
        topic = topics.get(record.channel_id, "")
        parts[topic] = record
        if topic == "pdm":
            try:
                ping = _ping(parts, info)
            except (FrameCorrupt, ValueError, KeyError, TypeError, RecursionError) as error:
                raise RecordingError(
                    f"{path} is damaged after {num_pings} pings ({error}): record it again"
                ) from error
            yield ping
            num_pings += 1
            parts = {}


def _ping(parts: dict[str, Message], info: RecordingInfo) -> RecordedPing:
    raw = decode_frame(parts["pdm"].data)
    if len(raw.words) != info.num_words:
        raise ValueError(f"frame of {len(raw.words)} words, expected {info.num_words}")
    if "ping" not in parts:
        raise ValueError(f"frame {raw.index} without its description")
    about: dict[str, Any] = json.loads(parts["ping"].data)
    truth = json.loads(parts["truth"].data) if "truth" in parts else None
    if about["ping_index"] != raw.index:
        raise ValueError(f"frame {raw.index} with the description of {about['ping_index']}")
    frame = PdmFrame(
        words=raw.words,
        ping_index=raw.index,
        ping_time_ns=parts["pdm"].log_time,
        time_uncertainty_ns=about["time_uncertainty_ns"],
        active=about["active"],
        pdm_rate_hz=info.pdm_rate_hz,
        clock_step_ns=about["clock_step_ns"],
    )
    return RecordedPing(frame, truth, about["temperature_c"])


def _records(path: Path) -> Iterator[McapRecord]:
    """All records of the data section, streamed; then the checks that only the end allows."""
    num_pings = 0
    ended = False
    try:
        with path.open("rb") as file:
            _check_magic(path, file)
            # Streaming, not seeking: a file without its end still yields what came before.
            reader = StreamReader(file, validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
            records = iter(reader.records)
            pdm_channels: set[int] = set()
            while True:
                try:
                    record = next(records, None)
                    if record is None:
                        break
                    ended = ended or isinstance(record, DataEnd)
                    if isinstance(record, Footer):
                        _check_summary(file)
                except DAMAGE as error:
                    raise _damage(path, file, error, num_pings) from error
                if isinstance(record, Channel) and record.topic == "pdm":
                    pdm_channels.add(record.id)
                if not ended:
                    yield record
                if isinstance(record, Message) and record.channel_id in pdm_channels:
                    num_pings += 1
    except OSError as error:
        raise RecordingError(
            f"cannot read {path} after {num_pings} pings: {error.strerror}"
        ) from error
    if not ended:
        raise RecordingError(f"{path} is damaged at its end, after {num_pings} pings")


def _check_summary(file: IO[bytes]) -> None:
    """Check what the stream reader does not: the checksum of all behind the data."""
    position = file.tell()
    end = file.seek(0, 2)
    if position != end - len(MAGIC):
        raise ValueError("bytes behind the end")
    file.seek(end - TAIL.size)
    tail = file.read(TAIL.size)
    _, _, start, _, expected, _ = TAIL.unpack(tail)
    file.seek(start)
    covered = file.read(max(0, end - start - len(MAGIC) - 4))
    if expected and zlib.crc32(covered) != expected:
        raise ValueError("checksum of the summary is wrong")
    file.seek(position)


def _check_magic(path: Path, file: IO[bytes]) -> None:
    first = file.read(len(MAGIC))
    file.seek(0)
    if not first:
        raise RecordingError(f"{path} is empty: nothing was recorded; name another file")
    if not MAGIC.startswith(first):
        raise RecordingError(f"{path} is no recording (not an MCAP file): name another file")


def _damage(path: Path, file: IO[bytes], error: Exception, num_pings: int) -> RecordingError:
    file.seek(max(0, file.seek(0, 2) - len(MAGIC)))
    if file.read() != MAGIC or file.tell() == len(MAGIC):
        return RecordingError(
            f"{path} is cut off after {num_pings} pings: the recorder was stopped or the disk was "
            "full; use those or record again"
        )
    what = "wrong checksum" if isinstance(error, CRCValidationError) else "broken record"
    return RecordingError(
        f"{path} is damaged after {num_pings} pings ({what}): use those or record again"
    )
