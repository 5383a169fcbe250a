"""What a recording holds: from its summary at once, or by reading and checking all of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ertis_driver.codec import PLAIN, PLANES
from ertis_driver.errors import RecordingDamaged, RecordingError
from ertis_driver.mcap_format import MAGIC, Damage
from ertis_driver.mcap_reader import NO_PING, Entry, damaged, make_ping, read_entries, read_info
from ertis_driver.mcap_summary import read_summary
from ertis_driver.ping_counter import missing_between
from ertis_driver.raw_recording import raw_info
from ertis_driver.recording_info import RecordingInfo


@dataclass(slots=True)
class Contents:
    """What is in a recording.

    num_bytes : int
        Of the file.
    num_messages : dict
        By topic; ``pdm`` is one a ping.
    start_ns, end_ns : int or None
        UNIX time of the first and last message; None if there is none, or none is told.
    is_compressed : bool
        Its frames are.
    has_end : bool
        It was closed.
    checked : bool
        All of it was read, and every checksum compared.
    pings_lost : int or None
        Gaps in the device's counter; None if not checked.
    damage : RecordingDamaged or None
        Where it is cut off or damaged; what is said above is then of what comes before.
    """

    info: RecordingInfo
    num_bytes: int
    num_messages: dict[str, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    is_compressed: bool = False
    has_end: bool = True
    checked: bool = False
    pings_lost: int | None = None
    damage: RecordingDamaged | None = None

    @property
    def num_pings(self) -> int:
        """Whole frames."""
        return self.num_messages.get("pdm", 0)

    @property
    def duration_s(self) -> float | None:
        """From the first message to the last, s."""
        if self.start_ns is None or self.end_ns is None:
            return None
        return (self.end_ns - self.start_ns) / 1e9


def inspect(path: Path, *, check: bool = False) -> Contents:
    """Say what a recording holds.

    Parameters
    ----------
    path
        MCAP, or headerless words.
    check
        Read all of it. Also done if it has no end that could tell.

    Raises
    ------
    RecordingError
        If it is no recording.
    """
    try:
        with path.open("rb") as file:
            first, size = file.read(len(MAGIC)), path.stat().st_size
        if first != MAGIC and path.suffix != ".mcap":
            return _raw(path, size)
        info = read_info(path)
        summary = read_summary(path)
    except FileNotFoundError as error:
        raise RecordingError(f"no recording {path}: check its name") from error
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error
    contents = Contents(info, size, has_end=summary is not None)
    if check or summary is None:
        _read_all(path, contents)
        return contents
    contents.num_messages = {topic: n for topic, n in summary.num_messages.items() if n}
    contents.is_compressed = summary.encodings.get("pdm", PLAIN) == PLANES
    if contents.num_messages:
        contents.start_ns, contents.end_ns = summary.start_ns, summary.end_ns
    return contents


def _raw(path: Path, size: int) -> Contents:
    info = raw_info(path, size)
    return Contents(info, size, {"pdm": size // (4 * info.num_words)}, checked=True)


def _read_all(path: Path, contents: Contents) -> None:
    contents.checked, contents.pings_lost = True, 0
    parts: dict[str, Any] = {}
    last_index: int | None = None
    try:
        for entry in read_entries(path):
            _count(contents, entry)
            parts[entry.channel.topic] = entry.message
            if entry.channel.topic != "pdm":
                continue
            index = _index_of(path, contents, entry, parts)
            if last_index is not None:
                contents.pings_lost += missing_between(last_index, index)
            last_index, parts = index, {}
    except RecordingDamaged as error:
        contents.damage = error


def _count(contents: Contents, entry: Entry) -> None:
    topic, time_ns = entry.channel.topic, entry.message.log_time
    contents.num_messages[topic] = contents.num_messages.get(topic, 0) + 1
    start_ns, end_ns = contents.start_ns, contents.end_ns
    contents.start_ns = time_ns if start_ns is None else min(time_ns, start_ns)
    contents.end_ns = time_ns if end_ns is None else max(time_ns, end_ns)
    if topic == "pdm":
        contents.is_compressed = entry.channel.message_encoding == PLANES


def _index_of(path: Path, contents: Contents, entry: Entry, parts: dict[str, Any]) -> int:
    try:
        ping = make_ping(parts, entry.channel.message_encoding, contents.info)
    except NO_PING as error:
        contents.num_messages["pdm"] -= 1
        raise damaged(path, Damage(entry.offset, str(error)), contents.num_pings) from error
    return ping.frame.ping_index
