"""Writes an MCAP file, chunk by chunk: what was written stays readable, whatever happens next."""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)

from ertis_driver.closing import Closing
from ertis_driver.errors import DiskFull, RecordingError
from ertis_driver.mcap_format import HEAD, MAGIC, Opcode
from ertis_driver.mcap_index import FileIndex, bytes_of

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log and publish time
_CHUNK = struct.Struct("<BQQQQIIQ")  # of one without compression
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One message to write."""

    channel: Channel
    time_ns: int
    sequence: int
    data: bytes


class McapWriter(Closing):
    """A new MCAP file. Each chunk is whole by itself, and written at once.

    A chunk repeats the schemas and channels of its messages, so that what is left of a damaged
    file explains itself. If the disk does not take a chunk, its beginning is cut off again.

    Parameters
    ----------
    path
        Nothing is overwritten.
    library
        Who writes.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written.

    Attributes
    ----------
    size : int
        Bytes in the file that are whole.
    """

    def __init__(self, path: Path, library: str) -> None:
        self.path = path
        self.size = 0
        self._data_crc = 0
        self._index = FileIndex()
        try:
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as error:
            raise RecordingError(f"{path} exists: name another file, or remove it") from error
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error
        self._is_open = True
        try:
            self._append(MAGIC, bytes_of(Header(profile="", library=library)))
        except RecordingError:
            self._give_up()
            raise

    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], **metadata: str
    ) -> Channel:
        """Make a channel, which appears with its first message.

        Parameters
        ----------
        schema
            Its name, encoding and data.
        """
        for known in self._index.schemas.values():
            if (known.name, known.encoding, known.data) == schema:
                break
        else:
            name, kind, data = schema
            known = Schema(id=len(self._index.schemas) + 1, name=name, encoding=kind, data=data)
            self._index.schemas[known.id] = known
        channel = Channel(len(self._index.channels) + 1, topic, encoding, metadata, known.id)
        self._index.channels[channel.id] = channel
        return channel

    def write_metadata(self, name: str, table: Mapping[str, str]) -> None:
        """Write a table of strings.

        Raises
        ------
        RecordingError
            If the disk does not take it.
        """
        data, offset = bytes_of(Metadata(name=name, metadata=dict(table))), self.size
        self._append(data)
        self._index.metadata.append(MetadataIndex(offset=offset, length=len(data), name=name))

    def write_chunk(self, messages: Sequence[Outgoing]) -> None:
        """Write messages as one chunk, which is on its way to the disk when this returns.

        Raises
        ------
        DiskFull
            If there is no room; the file ends where it did before.
        RecordingError
            If it cannot be written for another reason.
        """
        parts, places = self._chunk_parts(messages)
        size = sum(map(len, parts))
        times = [message.time_ns for message in messages]
        crc = 0
        for part in parts:
            crc = zlib.crc32(part, crc)
        length = _CHUNK.size - HEAD.size + size
        head = _CHUNK.pack(Opcode.CHUNK, length, min(times), max(times), size, crc, 0, size)
        start, chunk_length = self.size, len(head) + size
        tables: list[bytes] = []
        offsets: dict[int, int] = {}
        for channel_id, rows in places.items():
            offsets[channel_id] = start + chunk_length + sum(map(len, tables))
            tables.append(bytes_of(MessageIndex(channel_id, rows)))
        self._append(head, *parts, *tables)
        self._index.counts.update(message.channel.id for message in messages)
        self._index.chunks.append(
            ChunkIndex(
                chunk_start_offset=start,
                chunk_length=chunk_length,
                message_index_offsets=offsets,
                message_index_length=sum(map(len, tables)),
                message_start_time=min(times),
                message_end_time=max(times),
                compression="",
                compressed_size=size,
                uncompressed_size=size,
            )
        )

    def _chunk_parts(
        self, messages: Sequence[Outgoing]
    ) -> tuple[list[bytes], dict[int, list[tuple[int, int]]]]:
        """The bytes of a chunk, and per channel the time and place in it of each message."""
        channels = {message.channel.id: message.channel for message in messages}
        schemas = {self._index.schemas[channel.schema_id].id for channel in channels.values()}
        parts = [bytes_of(self._index.schemas[number]) for number in sorted(schemas)]
        parts += [bytes_of(channels[number]) for number in sorted(channels)]
        at = sum(map(len, parts))
        places: dict[int, list[tuple[int, int]]] = {}
        for item in messages:
            length = _MESSAGE.size - HEAD.size + len(item.data)
            number, time_ns = item.channel.id, item.time_ns
            head = _MESSAGE.pack(Opcode.MESSAGE, length, number, item.sequence, time_ns, time_ns)
            parts += [head, item.data]
            places.setdefault(number, []).append((time_ns, at))
            at += len(head) + len(item.data)
        return parts, places

    def sync(self) -> None:
        """Wait until all is on the disk: after this, no loss of power takes it.

        Raises
        ------
        RecordingError
            If the disk does not take it.
        """
        try:
            os.fdatasync(self._fd)
        except OSError as error:
            raise self._failed(error) from error

    def close(self, *, sync: bool = False) -> None:
        """Write the summary and close the file. May be called twice.

        Parameters
        ----------
        sync
            Wait until all is on the disk.

        Raises
        ------
        RecordingError
            If the disk does not take the end. The file is then one without an end, which can be
            read and recovered.
        """
        if not self._is_open:
            return
        try:
            end = bytes_of(DataEnd(self._data_crc))
            self._append(end, self._index.summary(self.size + len(end)), MAGIC)
            if sync:
                self.sync()
        finally:
            self._give_up()

    def _give_up(self) -> None:
        self._is_open = False
        os.close(self._fd)

    def _append(self, *parts: bytes) -> None:
        """Write all of it or nothing."""
        # Not joined: a frame would be copied. writev may take some of it only.
        left = [memoryview(part) for part in parts]
        try:
            while left:
                written = os.writev(self._fd, left)
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if left:
                    left[0] = left[0][written:]
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._fd, self.size)
                os.lseek(self._fd, self.size, os.SEEK_SET)
            raise self._failed(error) from error
        for part in parts:
            self._data_crc = zlib.crc32(part, self._data_crc)
            self.size += len(part)

    def _failed(self, error: OSError) -> RecordingError:
        if error.errno in _FULL:
            return DiskFull(f"cannot write {self.path}: {error.strerror}: free some space")
        return RecordingError(f"cannot write {self.path}: {error.strerror}")
