"""Labelled data sets: a folder of single-ping recordings, and ``metadata.csv`` which labels them.

``DATA/<environment>/<session>/0001_r48.mcap``. The label as it was recorded stays in the recording;
the table is the one to correct, and the one that training and evaluation believe.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ertis_driver.dataset_table import (
    COLUMNS,
    DatasetRow,
    Table,
    angle_text,
    check_file_name,
    format_table,
    parse_table,
    range_text,
)
from ertis_driver.errors import DatasetError, RecordingError
from ertis_driver.recording import RecordedPing, RecordingInfo, read_recording

__all__ = [
    "COLUMNS",
    "METADATA",
    "NONE",
    "PART",
    "Dataset",
    "DatasetRow",
    "file_sha256",
    "manifest_hash",
    "open_dataset",
    "path_in_dataset",
    "read_table",
    "replace_file",
    "sync_folder",
    "write_table",
]

METADATA = "metadata.csv"
NONE = "none"  # the label of a ping without landmark
PART = ".part"  # ends the name of what is not whole yet
MAX_TABLE_BYTES = 256 << 20
_REPORTED_PROBLEMS = 20
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Dataset:
    """A labelled data set.

    folder : Path
    columns : tuple of str
        Of ``metadata.csv``, in order.
    rows : tuple of DatasetRow
        In the order of ``metadata.csv``.
    manifest_hash : str
        What models and reports call the data set: see ``manifest_hash``.
    """

    folder: Path
    columns: tuple[str, ...]
    rows: tuple[DatasetRow, ...]
    manifest_hash: str

    def path(self, row: DatasetRow) -> Path:
        """Where a row's recording is; see ``path_in_dataset``."""
        return path_in_dataset(self.folder, row.file_name)

    def read(self, row: DatasetRow) -> tuple[RecordingInfo, RecordedPing]:
        """Read a row's recording.

        Raises
        ------
        RecordingError
            If it is missing, damaged, or of any other number of pings than one.
        """
        recording = read_recording(self.path(row))
        pings = iter(recording)
        ping = next(pings, None)
        if ping is None or next(pings, None) is not None:
            met = "no ping" if ping is None else "several pings"
            raise RecordingError(f"{recording.path} holds {met}, expected one, as {METADATA} says")
        return recording.info, ping


def open_dataset(folder: str | Path) -> Dataset:
    """Open a labelled data set; its recordings are read only when asked for.

    Raises
    ------
    DatasetError
        If there is no table, or anything in it is wrong: one line ``FILE:LINE: what`` each. Also if
        a file without recorded hash is missing.
    """
    folder = Path(folder)
    table = read_table(folder)
    if table.problems:
        shown = table.problems[:_REPORTED_PROBLEMS]
        lines = [f"{folder / METADATA}:{one.line}: {one.text}" for one in shown]
        if len(table.problems) > len(shown):
            lines.append(f"and {len(table.problems) - len(shown)} more in {folder / METADATA}")
        raise DatasetError("\n".join(lines))
    return Dataset(folder, table.columns, table.rows, manifest_hash(folder, table.rows))


def read_table(folder: str | Path) -> Table:
    """Read ``metadata.csv`` as far as it goes, with its problems line by line.

    Raises
    ------
    DatasetError
        If there is none, or it is no text.
    """
    path = Path(folder) / METADATA
    try:
        with path.open("rb") as file:
            data = file.read(MAX_TABLE_BYTES + 1)
        text = data.decode("utf-8")
    except FileNotFoundError as error:
        raise DatasetError(f"{folder} is no labelled data set: no {METADATA} in it") from error
    except NotADirectoryError as error:
        what = "a recording" if path.parent.suffix == ".mcap" else "a file"
        raise DatasetError(f"{folder} is {what}, expected the folder of a data set") from error
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise DatasetError(f"{path}:{line}: no UTF-8 text: save it as UTF-8") from error
    if len(data) > MAX_TABLE_BYTES:
        raise DatasetError(
            f"{path}: more than {MAX_TABLE_BYTES >> 20} MiB: this is no table of ours"
        )
    return parse_table(text)


def write_table(
    folder: str | Path, rows: Iterable[DatasetRow], columns: Sequence[str] = COLUMNS
) -> None:
    """Replace ``metadata.csv`` at one stroke: whoever reads it meets the old table or the new one.

    Raises
    ------
    DatasetError
        If a row's file name leads out of the folder, or the disk does not take the table.
    """
    rows = list(rows)
    for row in rows:
        if wrong := check_file_name(row.file_name):
            raise DatasetError(f"{Path(folder) / METADATA}: {wrong}")
    replace_file(Path(folder) / METADATA, format_table(rows, columns).encode("utf-8"))


def manifest_hash(folder: str | Path, rows: Iterable[DatasetRow]) -> str:
    """SHA-256 over all that learning or judging may depend on, in hexadecimal.

    File hashes, labels, positions, environments, sessions and qualities count; names and order of
    files, operators and unknown columns do not. Files themselves are read only where the table
    lacks their hash.

    Raises
    ------
    DatasetError
        If a file without recorded hash cannot be read.
    """
    lines = sorted(
        "\t".join(
            (
                row.sha256 or file_sha256(path_in_dataset(folder, row.file_name)),
                row.label,
                range_text(row.range_m),
                angle_text(row.azimuth_rad),
                angle_text(row.yaw_rad),
                row.environment,
                row.session,
                row.quality,
            )
        )
        for row in rows
    )
    return hashlib.sha256("\n".join(lines).encode("utf-8")).hexdigest()


def path_in_dataset(folder: str | Path, file_name: str) -> Path:
    """Where a recording is.

    Raises
    ------
    DatasetError
        If its name, or a symbolic link on the way, leads out of the folder.
    """
    if wrong := check_file_name(file_name):
        raise DatasetError(f"{Path(folder) / METADATA}: {wrong}")
    path = Path(folder) / file_name
    if not path.resolve().is_relative_to(Path(folder).resolve()):
        raise DatasetError(f"{path} is a link out of {folder}: put the recording itself there")
    return path


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal.

    Raises
    ------
    DatasetError
        If it cannot be read.
    """
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK_BYTES):
                digest.update(block)
    except FileNotFoundError as error:
        raise DatasetError(f"no recording {path}, which {METADATA} names: restore it") from error
    except OSError as error:
        raise DatasetError(f"cannot read {path}: {error.strerror}") from error
    return digest.hexdigest()


def replace_file(path: Path, data: bytes) -> None:
    """Write a file beside its place, force it to the disk, and rename it.

    Raises
    ------
    DatasetError
        If the disk does not take it; what was there before is there still.
    """
    part = path.with_name(path.name + PART)
    try:
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise DatasetError(f"cannot write {path}: {error.strerror}") from error


def sync_folder(folder: Path) -> None:
    """Force a folder's names to the disk: a rename alone may be forgotten in a power cut.

    Raises
    ------
    OSError
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
