"""The records of an MCAP file, from its beginning to its end, with every checksum compared."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import IO

from ertis_driver.mcap_format import (
    FOOTER,
    HEAD,
    MAGIC,
    MAX_RECORD_BYTES,
    Damage,
    Fields,
    Opcode,
    Record,
)


def records(file: IO[bytes]) -> Iterator[Record]:
    """Yield the records of the data section, chunks whole; then check the end.

    Streaming, not seeking: a file without its end still yields what came before. Before each
    record is yielded, only its length is known to be possible; the checksum of the whole data
    section is compared after its last.

    Parameters
    ----------
    file
        Open for reading at its beginning, seekable.

    Raises
    ------
    Damage
        Where the file is cut off or damaged.
    """
    size = file.seek(0, 2)
    file.seek(0)
    _check_magic(file.read(len(MAGIC)))
    crc = zlib.crc32(MAGIC)
    while True:
        record, head = read_record(file, size)
        if record.opcode == Opcode.DATA_END:
            break
        if record.opcode == Opcode.FOOTER:
            raise Damage(record.offset, "no end of data before the summary")
        yield record
        crc = zlib.crc32(record.content, zlib.crc32(head, crc))
    expected = _number(record, 4)
    if expected and expected != crc:
        raise Damage(record.offset, "wrong checksum of the whole")
    check_end(file, file.tell(), size)


def read_record(file: IO[bytes], size: int) -> tuple[Record, bytes]:
    """Read the next record of a file of ``size`` bytes; and the bytes before its content.

    Raises
    ------
    Damage
        If there is none, or not all of it.
    """
    offset = file.tell()
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        raise Damage(offset, "the end is missing", is_cut=True)
    opcode, length = HEAD.unpack(head)
    if not 0 < opcode <= Opcode.DATA_END:
        raise Damage(offset, f"record of unknown kind {opcode}")
    if length > MAX_RECORD_BYTES:
        raise Damage(offset, f"record of {length} bytes, expected at most {MAX_RECORD_BYTES}")
    content = file.read(length) if length <= size - offset - HEAD.size else b""
    if len(content) < length:
        # A length that lies is damage; of a file that was being written, the rest is missing.
        is_cut = not _has_end(file, size)
        raise Damage(offset, f"record of {length} bytes beyond the end of the file", is_cut=is_cut)
    return Record(offset, opcode, memoryview(content)), head


def check_end(file: IO[bytes], summary_start: int, size: int) -> None:
    """Check all behind the data: summary, footer and closing magic.

    Raises
    ------
    Damage
        If it is cut off or damaged.
    """
    offset, head, crc = summary_start, b"", 0
    file.seek(summary_start)
    record, head = read_record(file, size)
    while record.opcode != Opcode.FOOTER:
        crc = zlib.crc32(record.content, zlib.crc32(head, crc))
        record, head = read_record(file, size)
    offset = record.offset
    if len(record.content) != FOOTER.size:
        raise Damage(offset, f"footer of {len(record.content)} bytes, expected {FOOTER.size}")
    start, _, expected = FOOTER.unpack(record.content)
    crc = zlib.crc32(record.content[:-4], zlib.crc32(head, crc))
    if expected and crc != expected:
        raise Damage(summary_start, "wrong checksum of the summary")
    if start != summary_start and not (start == 0 and offset == summary_start):
        raise Damage(offset, f"summary said to begin at {start}, met at {summary_start}")
    end = file.read(len(MAGIC) + 1)
    if end != MAGIC:
        raise Damage(
            size, "bytes behind the end" if len(end) > len(MAGIC) else "the end is missing",
            is_cut=len(end) < len(MAGIC),
        )  # fmt: skip


def _check_magic(first: bytes) -> None:
    if len(first) < len(MAGIC) and MAGIC.startswith(first):
        raise Damage(0, "the end is missing", is_cut=True)
    if first != MAGIC:
        raise Damage(0, "not an MCAP file")


def _has_end(file: IO[bytes], size: int) -> bool:
    file.seek(max(len(MAGIC), size - len(MAGIC)))
    return file.read() == MAGIC


def _number(record: Record, size: int) -> int:
    try:
        return Fields(record.content).number(size)
    except ValueError as error:
        raise Damage(record.offset, str(error)) from error
