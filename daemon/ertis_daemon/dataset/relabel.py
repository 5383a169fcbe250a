"""Correcting the table: which rows, what they are to say, and a line in the journal for each."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from ertis_daemon.dataset.journal import Journal
from ertis_daemon.dataset.label import FOLDER_NAME, is_folder_name
from ertis_driver.dataset import NONE, Dataset, DatasetRow, write_table
from ertis_driver.dataset_table import parse_angle_rad, parse_range_m
from ertis_driver.errors import DatasetError

FIXED_COLUMNS = ("file_name", "sha256")
_FOLDERS = ("environment", "session")
_TEXTS = ("label", "environment", "session", "operator", "quality")
_PARSERS = {
    "range_m": ("range_m", parse_range_m),
    "azimuth_deg": ("azimuth_rad", parse_angle_rad),
    "yaw_deg": ("yaw_rad", parse_angle_rad),
}


def select(dataset: Dataset, patterns: Sequence[str]) -> list[DatasetRow]:
    """Return the rows whose file name fits a pattern such as ``garage/s1/*``.

    Raises
    ------
    DatasetError
        If a pattern fits none.
    """
    chosen: dict[str, DatasetRow] = {}
    for pattern in patterns:
        fitting = [row for row in dataset.rows if fnmatchcase(row.file_name, pattern)]
        if not fitting:
            raise DatasetError(f"no recording in {dataset.folder} is called {pattern}")
        chosen |= {row.file_name: row for row in fitting}
    return list(chosen.values())


def changed(row: DatasetRow, values: Mapping[str, str]) -> DatasetRow:
    """Return a row with other values, given as the table has them.

    Raises
    ------
    DatasetError
        If a value is not understood, or a column is not to be changed by hand.
    """
    fields: dict[str, Any] = {}
    extra = dict(row.extra)
    for name, text in values.items():
        if name in FIXED_COLUMNS:
            raise DatasetError(f"{name} belongs to the file: it cannot be changed")
        if any(not c.isprintable() for c in name + text) or not name:
            raise DatasetError(f"{name}={text!r}, expected printable text")
        if name in _PARSERS:
            field, parse = _PARSERS[name]
            try:
                fields[field] = parse(text)
            except ValueError as error:
                raise DatasetError(f"{name} {text!r}, expected {error}") from error
        elif name in _TEXTS:
            fields[name] = text.strip()
            if name in _FOLDERS and not is_folder_name(fields[name]):
                raise DatasetError(f"{name} {text!r}, expected {FOLDER_NAME}")
        else:
            extra[name] = text
    if fields.get("label") == "":
        raise DatasetError("label is blank, expected r35 and the like, or none")
    if fields.get("label") == NONE:
        fields.setdefault("yaw_rad", math.nan)
    return dataclasses.replace(row, **fields, extra=extra)


def apply(dataset: Dataset, rows: Sequence[DatasetRow]) -> int:
    """Put rows in the place of those of their names; returns how many differ. Hold the data set.

    Raises
    ------
    DatasetError
        If the disk does not take it.
    """
    new = {row.file_name: row for row in rows}
    journal = Journal(dataset.folder)
    count = 0
    for row in dataset.rows:
        after = new.get(row.file_name, row)
        # A label that is said again is confirmed: the journal tells `check`.
        if row.file_name in new:
            journal.note("relabel", row.file_name, before=_shown(row), after=_shown(after))
        count += after != row
    every = [new.get(row.file_name, row) for row in dataset.rows]
    write_table(dataset.folder, every, dataset.columns)
    return count


def differences(before: DatasetRow, after: DatasetRow) -> dict[str, tuple[Any, Any]]:
    """Columns that differ: what they said, what they say."""
    old, new = before.values(), after.values()
    names = dict.fromkeys([*old, *new])
    return {
        name: (old.get(name), new.get(name)) for name in names if old.get(name) != new.get(name)
    }


def _shown(row: DatasetRow) -> dict[str, Any]:
    return {name: value for name, value in row.values().items() if value not in ("", None)}
