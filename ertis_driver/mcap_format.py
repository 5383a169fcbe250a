"""The MCAP container, record by record: bytes to fields. Pure; see https://mcap.dev/spec."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Message, Metadata, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of a record: opcode, length of what follows
FOOTER = struct.Struct("<QQI")  # summary start, summary offset start, checksum of the summary
# Twice the longest frame: a length that lies must not take memory.
MAX_RECORD_BYTES = 1 << 27
_ZSTD_WINDOW_BYTES = 1 << 26


class Damage(Exception):
    """Bytes that are not what they should be.

    offset : int
        Of the record that holds them, in the file.
    what : str
        What is wrong.
    is_cut : bool
        The file ends too early.
    """

    def __init__(self, offset: int, what: str, *, is_cut: bool = False) -> None:
        super().__init__(what)
        self.offset, self.what, self.is_cut = offset, what, is_cut


class Fields:
    """Takes fields from the front of a record.

    Raises
    ------
    ValueError
        From each method, if the record is shorter than what it should hold.
    """

    def __init__(self, data: memoryview) -> None:
        self.data = data

    def take(self, count: int) -> memoryview:
        """So many bytes."""
        if count > len(self.data):
            raise ValueError(f"a field of {count} bytes where {len(self.data)} are left")
        taken, self.data = self.data[:count], self.data[count:]
        return taken

    def number(self, size: int) -> int:
        """An unsigned little-endian number of so many bytes."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """A string with its length before it."""
        return str(self.take(self.number(4)), "utf-8")

    def table(self) -> dict[str, str]:
        """Pairs of strings."""
        inner = Fields(self.take(self.number(4)))
        pairs: dict[str, str] = {}
        while len(inner.data):
            key = inner.text()
            pairs[key] = inner.text()
        return pairs

    def numbers(self, key_size: int, value_size: int) -> dict[int, int]:
        """Pairs of numbers."""
        inner = Fields(self.take(self.number(4)))
        pairs: dict[int, int] = {}
        while len(inner.data):
            key = inner.number(key_size)
            pairs[key] = inner.number(value_size)
        return pairs


def parse_schema(content: memoryview) -> Schema:
    """Read a schema record."""
    fields = Fields(content)
    number, name, encoding = fields.number(2), fields.text(), fields.text()
    return Schema(
        id=number, name=name, encoding=encoding, data=bytes(fields.take(fields.number(4)))
    )


def parse_channel(content: memoryview) -> Channel:
    """Read a channel record."""
    fields = Fields(content)
    number, schema, topic = fields.number(2), fields.number(2), fields.text()
    return Channel(number, topic, fields.text(), fields.table(), schema)


def parse_message(content: memoryview) -> Message:
    """Read a message record; its data is a view, not a copy."""
    fields = Fields(content)
    channel, sequence, log_time = fields.number(2), fields.number(4), fields.number(8)
    publish_time = fields.number(8)
    return Message(channel, log_time, fields.data, publish_time, sequence)  # type: ignore[arg-type]


def parse_metadata(content: memoryview) -> Metadata:
    """Read a metadata record."""
    fields = Fields(content)
    return Metadata(fields.text(), fields.table())


def parse_statistics(content: memoryview) -> Statistics:
    """Read a statistics record."""
    fields = Fields(content)
    names = (
        *("message_count", "schema_count", "channel_count", "attachment_count"),
        *("metadata_count", "chunk_count", "message_start_time", "message_end_time"),
    )
    sizes = (8, 2, 4, 4, 4, 4, 8, 8)
    values: dict[str, Any] = {n: fields.number(s) for n, s in zip(names, sizes, strict=True)}
    return Statistics(channel_message_counts=fields.numbers(2, 8), **values)


def parse_chunk_index(content: memoryview) -> ChunkIndex:
    """Read a chunk index record."""
    fields = Fields(content)
    start, end, offset, length = (fields.number(8) for _ in range(4))
    offsets, index_length, compression = fields.numbers(2, 8), fields.number(8), fields.text()
    return ChunkIndex(
        message_start_time=start,
        message_end_time=end,
        chunk_start_offset=offset,
        chunk_length=length,
        message_index_offsets=offsets,
        message_index_length=index_length,
        compression=compression,
        compressed_size=fields.number(8),
        uncompressed_size=fields.number(8),
    )


@dataclass(frozen=True, slots=True)
class Record:
    """One record.

    offset : int
        Where it, or the chunk around it, begins in the file.
    opcode : int
    content : memoryview
        What follows opcode and length.
    """

    offset: int
    opcode: int
    content: memoryview


def unpack_chunk(chunk: Record) -> list[Record]:
    """The records in a chunk, its checksum compared.

    Raises
    ------
    Damage
        If it is not what it says. Whatever it says, no more than ``MAX_RECORD_BYTES`` are
        decompressed.
    """
    fields = Fields(chunk.content)
    try:
        fields.take(16)  # the times of its messages
        size, crc, compression = fields.number(8), fields.number(4), fields.text()
        packed = fields.take(fields.number(8))
        if len(fields.data):
            raise ValueError(f"{len(fields.data)} bytes too many in a chunk")
        data = _decompress(packed, size, compression)
    except (ValueError, RuntimeError, zstandard.ZstdError) as error:
        raise Damage(chunk.offset, _one_line(error)) from error
    if crc and zlib.crc32(data) != crc:
        raise Damage(chunk.offset, "wrong checksum of a chunk")
    return list(_inner_records(data, chunk.offset))


def _decompress(packed: memoryview, size: int, compression: str) -> memoryview:
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes, expected at most {MAX_RECORD_BYTES}")
    data: Any = packed
    if compression == "zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=_ZSTD_WINDOW_BYTES)
        with decompressor.stream_reader(packed, read_across_frames=True) as reader:
            data = reader.read(size + 1)
    elif compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    elif compression:
        raise ValueError(f"compression {compression!r}, expected none, zstd or lz4")
    if len(data) != size:
        raise ValueError(f"a chunk that says {size} bytes and holds another number")
    return memoryview(data)


def _inner_records(data: memoryview, offset: int) -> Iterator[Record]:
    while len(data):
        if len(data) < HEAD.size:
            raise Damage(offset, "half a record at the end of a chunk")
        opcode, length = HEAD.unpack_from(data)
        if length > len(data) - HEAD.size:
            raise Damage(offset, f"a record of {length} bytes beyond the end of its chunk")
        yield Record(offset, opcode, data[HEAD.size : HEAD.size + length])
        data = data[HEAD.size + length :]


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


__all__ = [
    "FOOTER",
    "HEAD",
    "MAGIC",
    "MAX_RECORD_BYTES",
    "Damage",
    "Fields",
    "Opcode",
    "Record",
    "parse_channel",
    "parse_chunk_index",
    "parse_message",
    "parse_metadata",
    "parse_schema",
    "parse_statistics",
    "unpack_chunk",
]
