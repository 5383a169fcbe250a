"""What an MCAP file says at its end of all that is in it."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from mcap.data_stream import RecordBuilder
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ertis_driver.mcap_format import Opcode


@dataclass(slots=True)
class FileIndex:
    """Collected while a file is written; ``counts`` are messages by channel."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)

    def summary(self, start: int) -> bytes:
        """Schemas, channels, statistics, indexes and the footer, as bytes from ``start`` on."""
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, list(self.schemas.values())),
            (Opcode.CHANNEL, list(self.channels.values())),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        data, offsets = b"", b""
        for opcode, group in groups:
            if group:
                group_start = start + len(data)
                packed = b"".join(map(bytes_of, group))
                offsets += bytes_of(SummaryOffset(opcode, group_start, len(packed)))
                data += packed
        data += offsets
        footer = bytes_of(Footer(start, start + len(data) - len(offsets), 0))
        crc = zlib.crc32(footer[:-4], zlib.crc32(data))
        return data + footer[:-4] + struct.pack("<I", crc)

    def _statistics(self) -> Statistics:
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_start_time=min((chunk.message_start_time for chunk in self.chunks), default=0),
            message_end_time=max((chunk.message_end_time for chunk in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )


def bytes_of(record: McapRecord) -> bytes:
    """A record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
