"""Pings into a data set, one by one, so that a crash neither loses nor doubles a label.

A ping's recording is written beside its place and forced to the disk; the journal says what is
about to be done; the recording is renamed; the table is replaced. Resuming looks at what is there.
"""

from __future__ import annotations

import dataclasses
import json
import os
from pathlib import Path
from typing import Any

from ertis_daemon.dataset.journal import Journal
from ertis_daemon.dataset.label import Label, Place
from ertis_driver.dataset import (
    COLUMNS,
    METADATA,
    PART,
    DatasetRow,
    file_sha256,
    open_dataset,
    sync_folder,
    write_table,
)
from ertis_driver.dataset_table import angle_text, parse_table, range_text
from ertis_driver.errors import DatasetError, RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter, read_recording

FOLDER_DEPTH = "*/*/*"  # environment, session, recording


class DatasetRecorder:
    """A data set that is being recorded; hold it with ``locked``.

    Parameters
    ----------
    folder
        Of a data set, or new, or empty.

    Raises
    ------
    DatasetError
        If it holds something else, or its table is wrong: rewriting would lose what cannot be read.

    Attributes
    ----------
    rows : list of DatasetRow
        The table.
    resumed : list of str
        What was put right of an interrupted run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.resumed: list[str] = []
        self.journal = Journal(folder)
        self.rows: list[DatasetRow] = []
        self._columns: tuple[str, ...] = COLUMNS
        if (folder / METADATA).exists():
            dataset = open_dataset(folder)
            self.rows, self._columns = list(dataset.rows), dataset.columns
        elif not self.journal.entries and any(not p.name.startswith(".") for p in folder.iterdir()):
            raise DatasetError(f"{folder} is not empty and no data set: name a new folder")
        try:
            self._resume()
        except OSError as error:
            raise DatasetError(f"cannot write {error.filename}: {error.strerror}") from error

    def add(
        self, frame: PdmFrame, label: Label, place: Place, info: RecordingInfo, quality: str
    ) -> DatasetRow:
        """Take a ping in; returns its row once all is on the disk.

        Raises
        ------
        DatasetError, RecordingError
            If the disk does not take it.
        """
        name = self._next_name(label, place)
        path = self.folder / name
        part = path.with_name(path.name + PART)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            part.unlink(missing_ok=True)
            said = label.said(place)
            info = dataclasses.replace(info, label=json.dumps(said))
            with RecordingWriter(part, info) as writer:
                writer.write(frame, {"label": said})
            _sync_file(part)
            row = DatasetRow(
                file_name=name,
                label=label.label,
                range_m=label.range_m,
                azimuth_rad=label.azimuth_rad,
                yaw_rad=label.yaw_rad,
                environment=place.environment,
                session=place.session,
                operator=place.operator,
                sha256=file_sha256(part),
                quality=quality,
            )
            self.journal.note("add", name, row=_texts(row), temperature_c=place.temperature_c)
            part.rename(path)
            sync_folder(path.parent)
        except OSError as error:
            raise DatasetError(f"cannot write {path}: {error.strerror}") from error
        finally:
            part.unlink(missing_ok=True)
        self.rows.append(row)
        self._write()
        return row

    def undo(self) -> DatasetRow | None:
        """Take the last ping back, recording and row; None if there is none of this journal's.

        Raises
        ------
        DatasetError
            If the disk does not take it.
        """
        last = self.journal.last()
        order = {entry["file_name"]: at for at, entry in enumerate(self.journal.entries)}
        own = [row for row in self.rows if last.get(row.file_name, {}).get("do") == "add"]
        if not own:
            return None
        row = max(own, key=lambda row: order[row.file_name])
        self.journal.note("undo", row.file_name, sha256=row.sha256)
        self.rows.remove(row)
        self._write()
        (self.folder / row.file_name).unlink(missing_ok=True)
        return row

    def last_place(self) -> Place | None:
        """Where the last ping was recorded, if this folder's journal knows one."""
        for entry in reversed(self.journal.entries):
            row = entry.get("row")
            if entry.get("do") == "add" and isinstance(row, dict):
                return Place(
                    str(row.get("environment", "")),
                    str(row.get("session", "")),
                    str(row.get("operator", "")),
                    float(entry.get("temperature_c", 20.0)),
                )
        return None

    def last_label(self) -> Label | None:
        """What the last row says stands where."""
        if not self.rows:
            return None
        row = self.rows[-1]
        return Label(row.label, row.range_m, row.azimuth_rad, row.yaw_rad)

    def next_session(self, environment: str) -> str:
        """Name of a session that the environment does not have yet."""
        taken = {row.session for row in self.rows if row.environment == environment}
        number = 1
        while f"s{number}" in taken:
            number += 1
        return f"s{number}"

    def next_number(self, place: Place) -> int:
        """Number of the next ping of a session."""
        begin = f"{place.environment}/{place.session}/"
        names = [row.file_name.removeprefix(begin) for row in self.rows]
        names += [path.name for path in (self.folder / begin).glob("*.mcap")]
        numbers = [int(name[:4]) for name in names if "/" not in name and name[:4].isdecimal()]
        return max(numbers, default=0) + 1

    def _next_name(self, label: Label, place: Place) -> str:
        number = self.next_number(place)
        return f"{place.environment}/{place.session}/{number:04d}_{label.label}.mcap"

    def _resume(self) -> None:
        for part in self.folder.glob(f"{FOLDER_DEPTH}.mcap{PART}"):
            part.unlink()
            self.resumed.append(f"{part.name} was not whole yet: removed, ping it again")
        last = self.journal.last()
        # By hash as well: a file that was put back by hand may have the name of one undone.
        undone = {(n, entry.get("sha256")) for n, entry in last.items() if entry["do"] == "undo"}
        kept = [row for row in self.rows if (row.file_name, row.sha256) not in undone]
        changed = len(kept) < len(self.rows)
        self.rows = kept
        known = {row.file_name for row in kept}
        for path in sorted(self.folder.glob(f"{FOLDER_DEPTH}.mcap")):
            name = path.relative_to(self.folder).as_posix()
            if name in known:
                continue
            if (name, file_sha256(path)) in undone:
                path.unlink()
                self.resumed.append(f"{name} was being undone: removed")
            else:
                row = self._stray_row(name, last.get(name))
                if row is not None:
                    self.rows.append(row)
                    changed = True
        if changed:
            self._write()

    def _stray_row(self, name: str, entry: dict[str, Any] | None) -> DatasetRow | None:
        """Row of a recording that the table lacks: the journal's, or what the recording says."""
        path = self.folder / name
        row = None
        if entry is not None and isinstance(entry.get("row"), dict):
            row = _row_of_texts(entry["row"])
        if row is None or row.file_name != name or row.sha256 != file_sha256(path):
            row = _recorded_row(path, name)
        if row is None:
            self.resumed.append(f"{name} is not in the table and has no label: left alone")
            return None
        self.resumed.append(f"{name} was not in the table yet: taken in as {row.label}")
        return row

    def _write(self) -> None:
        write_table(self.folder, self.rows, self._columns)


def recorded_label(path: Path) -> dict[str, Any] | None:
    """Return the label as it was recorded, if there is one.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    """
    truth = next((ping.truth for ping in read_recording(path)), None)
    label = (truth or {}).get("label")
    return label if isinstance(label, dict) and label.get("label") else None


def _recorded_row(path: Path, name: str) -> DatasetRow | None:
    try:
        said = recorded_label(path)
    except RecordingError:
        return None
    if said is None:
        return None
    texts = {key: "" if value is None else str(value) for key, value in said.items()}
    return _row_of_texts(texts | {"file_name": name, "sha256": file_sha256(path)})


def _texts(row: DatasetRow) -> dict[str, str]:
    return {
        **{name: str(value) for name, value in row.values().items() if name in COLUMNS},
        "range_m": range_text(row.range_m),
        "azimuth_deg": angle_text(row.azimuth_rad),
        "yaw_deg": angle_text(row.yaw_rad),
    }


def _row_of_texts(texts: dict[str, Any]) -> DatasetRow | None:
    """A row of the table's own texts; None if one of them is wrong: a file may hold anything."""
    cells = [str(texts.get(name, "")).replace('"', "").replace("\n", " ") for name in COLUMNS]
    table = parse_table("\n".join([",".join(COLUMNS), ",".join(f'"{cell}"' for cell in cells)]))
    return table.rows[0] if table.rows else None


def _sync_file(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
