"""Saves what is whole of a damaged recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Channel, Message, Schema

from ertis_driver.codec import PLANES, decode_recorded
from ertis_driver.errors import FrameCorrupt, RecordingError
from ertis_driver.mcap_format import (
    HEAD,
    Opcode,
    Record,
    parse_channel,
    parse_message,
    parse_metadata,
    parse_schema,
)
from ertis_driver.mcap_reader import NO_PING, make_ping
from ertis_driver.mcap_salvage import Hole, salvage
from ertis_driver.mcap_summary import read_summary
from ertis_driver.mcap_writer import McapWriter, Outgoing
from ertis_driver.recording_info import (
    CREATED_BY,
    METADATA,
    METADATA_COPY,
    RecordingInfo,
    from_strings,
    to_strings,
)

_OF_A_PING = ("ping", "truth", "truth/points")


@dataclass(slots=True)
class Recovery:
    """What was saved of a recording.

    num_pings : int
        Saved; each is whole.
    pings_lost : int
        That were in it and are not: by their numbers, and the one that was being written.
    other_messages : int
        Events, pictures, log lines and the like, saved.
    bytes_lost : int
        Of no use.
    holes : list of Hole
        Where, and what was wrong.
    info_lost : bool
        Neither copy of what the recording said about itself is whole.
    """

    num_pings: int = 0
    pings_lost: int = 0
    other_messages: int = 0
    bytes_lost: int = 0
    holes: list[Hole] = field(default_factory=list)
    info_lost: bool = False

    @property
    def was_whole(self) -> bool:
        """Nothing was wrong with it."""
        return not (self.holes or self.pings_lost or self.info_lost)


def recover(path: Path, output: Path) -> Recovery:
    """Write all that is whole of a recording to another file, which has an end again.

    Parameters
    ----------
    path
        A recording, damaged or not.
    output
        A new file; it appears once it is complete.

    Raises
    ------
    RecordingError
        If nothing of a recording is in it, or a file cannot be read or written.
    """
    if output.exists():
        raise RecordingError(f"{output} exists: name another file, or remove it")
    part = output.with_name(output.name + ".part")
    part.unlink(missing_ok=True)
    try:
        info = _find_info(path)
        recovery = Recovery(info_lost=info is None)
        info = info or _guess_info(path)
        with McapWriter(part, CREATED_BY) as writer:
            for name in (METADATA, METADATA_COPY):
                writer.write_metadata(name, to_strings(info))
            _Saving(writer, info, recovery).copy(path)
        if not (recovery.num_pings or recovery.other_messages):
            raise _nothing(path)
        _count_tail(path, info, recovery)
        part.replace(output)
    except OSError as error:
        raise RecordingError(f"cannot recover {path}: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)
    return recovery


class _Saving:
    """Copies the messages of a file: pings only whole, all else as it comes."""

    def __init__(self, writer: McapWriter, info: RecordingInfo, recovery: Recovery) -> None:
        self._writer, self._info, self._recovery = writer, info, recovery
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._made: dict[tuple[str, str], Channel] = {}
        self._parts: dict[str, tuple[Channel, Message]] = {}
        self._expected = 0

    def copy(self, path: Path) -> None:
        with path.open("rb") as file:
            for found in salvage(file):
                if isinstance(found, Hole):
                    self._recovery.holes.append(found)
                    self._recovery.bytes_lost += found.end - found.start
                    self._parts = {}
                else:
                    self._take(found)

    def _take(self, record: Record) -> None:
        try:
            if record.opcode == Opcode.SCHEMA:
                schema = parse_schema(record.content)
                self._schemas[schema.id] = schema
            elif record.opcode == Opcode.CHANNEL:
                channel = parse_channel(record.content)
                self._channels[channel.id] = channel
            elif record.opcode == Opcode.MESSAGE:
                message = parse_message(record.content)
                self._take_message(self._channels[message.channel_id], message)
        except (ValueError, KeyError) as error:
            self._recovery.holes.append(Hole(record.offset, record.offset, str(error)))

    def _take_message(self, channel: Channel, message: Message) -> None:
        if channel.topic in _OF_A_PING:
            self._parts[channel.topic] = channel, message
        elif channel.topic == "pdm":
            self._parts["pdm"] = channel, message
            self._take_ping(channel, message)
            self._parts = {}
        else:
            self._write([(channel, message)])
            self._recovery.other_messages += 1

    def _take_ping(self, channel: Channel, message: Message) -> None:
        # A recording that was split, or cut before, need not begin with 0.
        if self._recovery.num_pings or self._recovery.holes:
            self._recovery.pings_lost += max(0, message.sequence - self._expected)
        self._expected = message.sequence + 1
        messages = {topic: part for topic, (_, part) in self._parts.items()}
        try:
            make_ping(messages, channel.message_encoding, self._info)
        except NO_PING as error:
            what = f"no whole ping: {error}"
            self._recovery.holes.append(Hole(-1, -1, what))
            self._recovery.pings_lost += 1
            return
        self._write(list(self._parts.values()))
        self._recovery.num_pings += 1

    def _write(self, messages: list[tuple[Channel, Message]]) -> None:
        self._writer.write_chunk(
            [
                Outgoing(self._channel(channel), item.log_time, item.sequence, item.data)
                for channel, item in messages
            ]
        )

    def _channel(self, channel: Channel) -> Channel:
        key = channel.topic, channel.message_encoding
        if key not in self._made:
            schema = self._schemas.get(channel.schema_id) or Schema(0, b"", "", "")
            self._made[key] = self._writer.add_channel(
                *key, (schema.name, schema.encoding, schema.data), **channel.metadata
            )
        return self._made[key]


def _records(path: Path) -> Iterator[Record]:
    with path.open("rb") as file:
        yield from (found for found in salvage(file) if isinstance(found, Record))


def _find_info(path: Path) -> RecordingInfo | None:
    """What the recording says about itself, of the first copy that is whole; None if none is."""
    for record in _records(path):
        if record.opcode == Opcode.METADATA:
            try:
                metadata = parse_metadata(record.content)
                if metadata.name in (METADATA, METADATA_COPY):
                    return from_strings(metadata.metadata)
            except ValueError:
                continue
        if record.opcode == Opcode.MESSAGE:
            break  # both stand before the first
    return None


def _guess_info(path: Path) -> RecordingInfo:
    """The little that a ping itself tells: its length. Who made it is not known any more."""
    topics: dict[int, Channel] = {}
    for record in _records(path):
        try:
            if record.opcode == Opcode.CHANNEL:
                channel = parse_channel(record.content)
                topics[channel.id] = channel
            if record.opcode != Opcode.MESSAGE:
                continue
            message = parse_message(record.content)
            channel = topics[message.channel_id]
            if channel.topic == "pdm":
                num_words = _num_words(message, channel.message_encoding)
                return RecordingInfo("replay", None, num_words, note="recovered without metadata")
        except (FrameCorrupt, ValueError, KeyError):
            continue
    raise _nothing(path)


def _nothing(path: Path) -> RecordingError:
    return RecordingError(f"{path} holds no whole ping of a sonar recording: nothing to recover")


def _num_words(message: Message, encoding: str) -> int:
    if encoding == PLANES:
        return int.from_bytes(message.data[4:8], "little")
    return len(decode_recorded(message.data, encoding, 0).words)


def _count_tail(path: Path, info: RecordingInfo, recovery: Recovery) -> None:
    """Count pings lost at the end: those that the summary knows of, or the one half written."""
    last = recovery.holes[-1] if recovery.holes else None
    if last is None or not last.is_cut:
        return
    summary = read_summary(path)
    if summary is not None:
        recovery.pings_lost = max(summary.num_pings - recovery.num_pings, recovery.pings_lost)
        return
    with path.open("rb") as file:
        file.seek(last.start)
        head = file.read(HEAD.size)
    # What is half written tells its length; events and the end are much shorter than a ping.
    is_short = len(head) == HEAD.size and HEAD.unpack(head)[1] < info.num_words // 2
    if head and not is_short:
        recovery.pings_lost += 1
