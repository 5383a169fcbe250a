"""What a recording's end says of the whole, without reading all of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ertis_driver.mcap_format import (
    FOOTER,
    HEAD,
    MAGIC,
    Damage,
    Opcode,
    parse_channel,
    parse_statistics,
)
from ertis_driver.mcap_stream import check_end, read_record

_TAIL_BYTES = HEAD.size + FOOTER.size + len(MAGIC)


@dataclass(frozen=True, slots=True)
class Summary:
    """Counted when the recording was closed.

    num_messages : dict
        By topic; ``pdm`` is one a ping.
    encodings : dict
        How each topic's messages are written.
    start_ns, end_ns : int
        Times of the first and last message.
    """

    num_messages: dict[str, int]
    encodings: dict[str, str]
    start_ns: int
    end_ns: int

    @property
    def num_pings(self) -> int:
        """Frames in the recording."""
        return self.num_messages.get("pdm", 0)


def read_summary(path: Path) -> Summary | None:
    """Read the summary; None if the file has no end, or a damaged one.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        try:
            file.seek(max(0, size - _TAIL_BYTES))
            footer, _ = read_record(file, size)
            if footer.opcode != Opcode.FOOTER or len(footer.content) != FOOTER.size:
                return None
            start, _, _ = FOOTER.unpack(footer.content)
            if not start:
                return None
            check_end(file, start, size)
            file.seek(start)
            return _parse(file, size)
        except (Damage, ValueError):
            return None


def _parse(file: IO[bytes], size: int) -> Summary | None:
    topics: dict[int, str] = {}
    encodings: dict[str, str] = {}
    while True:
        record, _ = read_record(file, size)
        if record.opcode == Opcode.CHANNEL:
            channel = parse_channel(record.content)
            topics[channel.id] = channel.topic
            encodings[channel.topic] = channel.message_encoding
        elif record.opcode == Opcode.STATISTICS:
            said = parse_statistics(record.content)
            counts = {
                topics.get(number, str(number)): count
                for number, count in said.channel_message_counts.items()
            }
            return Summary(counts, encodings, said.message_start_time, said.message_end_time)
        elif record.opcode == Opcode.FOOTER:
            return None
