"""Labelled recordings: where they are, and whether truth or the table's line is believed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ertis_driver.dataset import NONE, DatasetRow, open_dataset
from ertis_driver.errors import SettingsError


def recordings_in(paths: Iterable[Path]) -> list[tuple[Path, DatasetRow | None]]:
    """Recordings, and those of labelled data sets with their lines of the table.

    Raises
    ------
    DatasetError
        If a data set cannot be read.
    SettingsError
        As ``each_once``.
    """
    files: list[Path] = []
    rows: dict[Path, DatasetRow | None] = {}
    for path in paths:
        if path.is_dir():
            data = open_dataset(path)
            found = {data.path(row): row for row in data.rows}
            files += found
            rows |= found
        else:
            files.append(path)
    return [(file, rows.get(file)) for file in each_once(files)]


def each_once(paths: Iterable[Path]) -> list[Path]:
    """The same paths.

    Raises
    ------
    SettingsError
        If two of them are of one file: its pings would count twice.
    """
    met: dict[Path, Path] = {}
    for path in paths:
        file = path.resolve()
        if file in met:
            raise SettingsError(f"{path} is given twice, first as {met[file]}: name it once")
        met[file] = path
    return list(met.values())


def recorded_truth(
    row: DatasetRow | None, recorded: dict[str, Any] | None
) -> dict[str, Any] | None:
    """What the recording says stands where; None if its table's line is to be believed instead.

    A simulator knows everything and is believed, unless somebody corrected the label. A person's
    recording knows no more than the label it was made with.

    Parameters
    ----------
    row : DatasetRow or None
        None for a recording of no data set: then it alone is believed.
    recorded : dict or None
        The ping's truth, as its recording has it.
    """
    if recorded is None or "landmarks" not in recorded:
        return None
    if row is None:
        return recorded
    landmarks = recorded["landmarks"]
    label = str(landmarks[0]["label"]) if landmarks else NONE
    return recorded if label == row.label else None
