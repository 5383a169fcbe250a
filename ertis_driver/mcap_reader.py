"""Reads the MCAP recordings that ``recording`` writes, and says in one line what is wrong."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message

from ertis_driver.codec import decode_recorded
from ertis_driver.errors import FrameCorrupt, RecordingDamaged, RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.mcap_format import (
    Damage,
    Opcode,
    Record,
    parse_channel,
    parse_message,
    parse_metadata,
    unpack_chunk,
)
from ertis_driver.mcap_stream import records
from ertis_driver.recording_info import METADATA, RecordedPing, RecordingInfo, from_strings

# What ``make_ping`` raises; the last three JSON of the wrong kind.
NO_PING = (FrameCorrupt, ValueError, KeyError, TypeError, RecursionError)


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a recording.

    offset : int
        Of the chunk that holds it.
    channel : Channel
    message : Message
        Its data is a view of that chunk.
    """

    offset: int
    channel: Channel
    message: Message


def read_info(path: Path) -> RecordingInfo:
    """Read what the recording says about itself.

    Raises
    ------
    RecordingError
        If it is no recording of ours.
    """
    for record in _checked_records(path, _Counter()):
        if record.opcode == Opcode.METADATA:
            metadata = _parsed(path, record)
            if metadata.name != METADATA:
                continue
            try:
                return from_strings(metadata.metadata)
            except ValueError as error:
                raise RecordingError(
                    f"{path}: {error}; `ertis recover` may save its pings"
                ) from error
        if record.opcode in (Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK):
            break
    raise RecordingError(f"{path} is an MCAP file, but no sonar recording: name another file")


def read_entries(path: Path) -> Iterator[Entry]:
    """Yield all messages in the order of the file.

    Raises
    ------
    RecordingDamaged
        Where the file is cut off or damaged, after the messages before that.
    RecordingError
        If it cannot be read.
    """
    counter = _Counter()
    channels: dict[int, Channel] = {}
    for record in _checked_records(path, counter):
        try:
            chunk = record.opcode == Opcode.CHUNK
            for inner in unpack_chunk(record) if chunk else [record]:
                if inner.opcode == Opcode.CHANNEL:
                    channel = parse_channel(inner.content)
                    channels[channel.id] = channel
                elif inner.opcode == Opcode.MESSAGE:
                    message = parse_message(inner.content)
                    channel = channels[message.channel_id]
                    yield Entry(record.offset, channel, message)
                    counter.pings += channel.topic == "pdm"
        except Damage as error:
            raise damaged(path, error, counter.pings) from error
        except KeyError as error:
            damage = Damage(record.offset, f"message of unknown channel {error}")
            raise damaged(path, damage, counter.pings) from error
        except ValueError as error:
            raise damaged(path, Damage(record.offset, str(error)), counter.pings) from error


def read_pings(path: Path, info: RecordingInfo) -> Iterator[RecordedPing]:
    """Yield the pings in order.

    Raises
    ------
    RecordingDamaged
        Where the file is cut off or damaged, after the pings before that.
    """
    parts: dict[str, Message] = {}
    num_pings = 0
    for entry in read_entries(path):
        topic = entry.channel.topic
        parts[topic] = entry.message
        if topic != "pdm":
            continue
        try:
            ping = make_ping(parts, entry.channel.message_encoding, info)
        except NO_PING as error:
            what = str(error) or type(error).__name__
            raise damaged(path, Damage(entry.offset, what), num_pings) from error
        yield ping
        num_pings += 1
        parts = {}


def make_ping(parts: dict[str, Message], encoding: str, info: RecordingInfo) -> RecordedPing:
    """Put a ping together from its messages, by topic.

    Raises
    ------
    FrameCorrupt, ValueError, KeyError, TypeError, RecursionError
        If they are not those of one ping.
    """
    raw = decode_recorded(parts["pdm"].data, encoding, info.num_words)
    if len(raw.words) != info.num_words:
        raise ValueError(f"frame of {len(raw.words)} words, expected {info.num_words}")
    if "ping" not in parts:
        raise ValueError(f"frame {raw.index} without its description")
    about: dict[str, Any] = json.loads(bytes(parts["ping"].data))
    truth = json.loads(bytes(parts["truth"].data)) if "truth" in parts else None
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
    return RecordedPing(frame, truth, about["temperature_c"], about.get("humidity_percent"))


@dataclass(slots=True)
class _Counter:
    """Of the whole pings so far: what a message about damage names."""

    pings: int = 0


def _checked_records(path: Path, counter: _Counter) -> Iterator[Record]:
    try:
        with path.open("rb") as file:
            yield from records(file)
    except Damage as error:
        raise damaged(path, error, counter.pings) from error
    except OSError as error:
        raise RecordingError(
            f"cannot read {path} after {counter.pings} pings: {error.strerror}"
        ) from error


def _parsed(path: Path, record: Record) -> Any:
    try:
        return parse_metadata(record.content)
    except ValueError as error:
        raise damaged(path, Damage(record.offset, str(error)), 0) from error


def damaged(path: Path, damage: Damage, num_pings: int) -> RecordingError:
    """The error that says where a recording is damaged, in one line."""
    if damage.offset == 0 and not damage.is_cut:
        return RecordingError(f"{path} is no recording ({damage.what}): name another file")
    if damage.offset == 0 and path.stat().st_size == 0:
        return RecordingError(f"{path} is empty: nothing was recorded; name another file")
    what = "cut off" if damage.is_cut else "damaged"
    why = "the recorder was stopped or the disk was full" if damage.is_cut else damage.what
    return RecordingDamaged(
        f"{path} is {what} at byte {damage.offset}, after {num_pings} whole pings ({why}): "
        f"`ertis recover {path}` saves what is left",
        offset=damage.offset,
        num_pings=num_pings,
        is_cut=damage.is_cut,
    )
