"""The records that are whole in a damaged MCAP file, wherever they stand."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

from ertis_driver.mcap_format import HEAD, MAGIC, Damage, Opcode, Record, unpack_chunk
from ertis_driver.mcap_stream import read_record

# A chunk's opcode, and a length below MAX_RECORD_BYTES: one of 30 million random places.
_CHUNK_HEAD = re.compile(rb"\x06...[\x00-\x08]\x00\x00\x00\x00", re.DOTALL)
_WINDOW_BYTES = 1 << 20
_DATA = (
    *(Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK),
    *(Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END),
)


@dataclass(frozen=True, slots=True)
class Hole:
    """Bytes of no use.

    start, end : int
        Offsets in the file.
    what : str
        What is wrong with the first of them.
    is_cut : bool
        The file ends in it.
    """

    start: int
    end: int
    what: str
    is_cut: bool = False


def salvage(file: IO[bytes]) -> Iterator[Record | Hole]:
    """Yield the records of the data section, chunks unpacked; and what lies between them.

    After damage it goes on at the next chunk whose checksum is right. Ends with the end of the
    data, or of the file.
    """
    size = file.seek(0, 2)
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        yield Hole(0, min(size, len(MAGIC)), "wrong first bytes")
    offset = len(MAGIC)
    while offset < size:
        file.seek(offset)
        try:
            record, _ = read_record(file, size)
            if record.opcode not in _DATA:
                raise Damage(offset, f"record of kind {record.opcode} among the data")
            inner = unpack_chunk(record) if record.opcode == Opcode.CHUNK else [record]
        except Damage as error:
            found = _next_chunk(file, offset + 1, size)
            end = size if found is None else found
            yield Hole(offset, end, error.what, is_cut=found is None)
            if found is None:
                return
            offset = found
            continue
        yield from inner
        if record.opcode == Opcode.DATA_END:
            return
        offset += HEAD.size + len(record.content)
    yield Hole(size, size, "the end is missing", is_cut=True)


def _next_chunk(file: IO[bytes], start: int, size: int) -> int | None:
    """Where the next whole chunk begins."""
    while start < size:
        file.seek(start)
        window = file.read(_WINDOW_BYTES + HEAD.size - 1)
        for match in _CHUNK_HEAD.finditer(window):
            offset = start + match.start()
            file.seek(offset)
            try:
                unpack_chunk(read_record(file, size)[0])
            except Damage:
                continue
            return offset
        start += _WINDOW_BYTES
    return None
