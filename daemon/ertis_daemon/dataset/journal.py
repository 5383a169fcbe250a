"""What was done to a data set, one JSON line each, on the disk before it is done.

Table and recordings cannot change at one stroke: after a crash between the two, the journal tells a
ping that was being taken in from one that was being taken back.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any, Literal

from ertis_driver.errors import DatasetError

JOURNAL = "journal.jsonl"
MAX_JOURNAL_BYTES = 1 << 30
Deed = Literal["add", "undo", "relabel"]


class Journal:
    """The journal of one data set; empty if there is none yet.

    Parameters
    ----------
    folder
        The data set's.

    Raises
    ------
    DatasetError
        If it cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        self.entries: list[dict[str, Any]] = []
        self._ends_torn = False
        try:
            if self.path.exists():
                if self.path.stat().st_size > MAX_JOURNAL_BYTES:
                    raise DatasetError(f"{self.path}: over {MAX_JOURNAL_BYTES >> 30} GiB: move it")
                self._read(self.path.read_bytes())
        except OSError as error:
            raise DatasetError(f"cannot read {self.path}: {error.strerror}") from error

    def _read(self, data: bytes) -> None:
        # Whoever died in mid-line had not begun to do what the line says.
        self._ends_torn = bool(data) and not data.endswith(b"\n")
        for line in data.split(b"\n"):
            try:
                entry = json.loads(line) if line.strip() else None
            except (ValueError, RecursionError):
                continue
            if isinstance(entry, dict) and isinstance(entry.get("file_name"), str):
                self.entries.append(entry)

    def note(self, deed: Deed, file_name: str, **more: Any) -> None:
        """Append a line, and return when it is on the disk.

        Raises
        ------
        DatasetError
            If the disk does not take it.
        """
        at = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        entry = {"time": at, "do": deed, "file_name": file_name, **more}
        line = json.dumps(entry, ensure_ascii=False, allow_nan=False)
        try:
            with self.path.open("ab") as file:
                file.write(b"\n" * self._ends_torn + line.encode() + b"\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            self._ends_torn = True
            raise DatasetError(f"cannot write {self.path}: {error.strerror}") from error
        self._ends_torn = False
        self.entries.append(entry)

    def last(self) -> dict[str, dict[str, Any]]:
        """By file name, the last line that took it in or back."""
        return {
            entry["file_name"]: entry
            for entry in self.entries
            if entry.get("do") in ("add", "undo")
        }

    def relabelled(self) -> set[str]:
        """Names of the files whose row was changed on purpose."""
        return {entry["file_name"] for entry in self.entries if entry.get("do") == "relabel"}
