"""``metadata.csv``, the table of a labelled data set: text to rows and back."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

NUMBER_COLUMNS = ("range_m", "azimuth_deg", "yaw_deg")
COLUMNS = (
    "file_name",
    "label",
    *NUMBER_COLUMNS,
    "environment",
    "session",
    "operator",
    "sha256",
    "quality",
)
MAX_ROWS = 1_000_000
MAX_CELL_CHARACTERS = 4096
_NAN = float("nan")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")


@dataclass(frozen=True, slots=True)
class DatasetRow:
    """One ping of a labelled data set: its recording, and what stood where.

    file_name : str
        Recording, relative to the data set's folder, with ``/`` between folders.
    label : str
        ``r35`` and so on (aperture radius, mm), or ``none``.
    range_m : float
        To the landmark, or to where one would be; NaN if not known.
    azimuth_rad : float
        Of the same, + left; NaN if not known.
    yaw_rad : float
        Turn of the landmark's opening away from the sonar, + left; NaN if not known or none.
    environment, session, operator : str
        Where, in which run and by whom; may be empty.
    sha256 : str
        Of the recording, in hexadecimal; may be empty.
    quality : str
        ``good`` or what is wrong with it; may be empty.
    extra : mapping
        Columns of other names.
    line : int
        In ``metadata.csv``; 0 if it never stood there.
    cells : mapping
        The text as it was read: what does not change is written back unchanged.
    """

    file_name: str
    label: str
    range_m: float = _NAN
    azimuth_rad: float = _NAN
    yaw_rad: float = _NAN
    environment: str = ""
    session: str = ""
    operator: str = ""
    sha256: str = ""
    quality: str = ""
    extra: Mapping[str, str] = field(default_factory=dict)
    line: int = field(default=0, compare=False)
    cells: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    def values(self) -> dict[str, Any]:
        """All columns by name, as users see them: numbers in m and degrees, None for unknown."""
        return {
            "file_name": self.file_name,
            "label": self.label,
            "range_m": _known(self.range_m),
            "azimuth_deg": _known(math.degrees(self.azimuth_rad)),
            "yaw_deg": _known(math.degrees(self.yaw_rad)),
            "environment": self.environment,
            "session": self.session,
            "operator": self.operator,
            "sha256": self.sha256,
            "quality": self.quality,
            **self.extra,
        }


@dataclass(frozen=True, slots=True)
class TableProblem:
    """What is wrong in one line of the table.

    line : int
        Counted from 1.
    file_name : str
        Of that line's recording; empty if there is none.
    text : str
        What was met, what was expected.
    """

    line: int
    file_name: str
    text: str


@dataclass(frozen=True, slots=True)
class Table:
    """A table, as far as it could be read.

    columns : names in their order
    rows : the good ones
    problems : everything else
    """

    columns: tuple[str, ...]
    rows: tuple[DatasetRow, ...]
    problems: tuple[TableProblem, ...]


def parse_table(text: str) -> Table:
    """Read a table; never fails, but says line by line what is wrong."""
    lines = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=None), strict=True)
    rows: list[DatasetRow] = []
    problems: list[TableProblem] = []
    columns: tuple[str, ...] = ()
    seen: dict[str, int] = {}
    try:
        columns = tuple(cell.strip() for cell in next(lines, []))
        problems += [TableProblem(1, "", said) for said in _wrong_columns(columns)]
        if problems:
            return Table(columns, (), tuple(problems))
        for cells in lines:
            if not any(cell.strip() for cell in cells):
                continue
            row, wrong = _read_row(columns, cells, lines.line_num)
            name = row.file_name if row is not None else cells[0].strip()
            if name and name in seen:
                wrong.append(f"{name} stands in line {seen[name]} already: keep one of them")
            seen.setdefault(name, lines.line_num)
            problems += [TableProblem(lines.line_num, name, said) for said in wrong]
            if row is not None and not wrong:
                rows.append(row)
            if len(seen) > MAX_ROWS:
                problems.append(TableProblem(lines.line_num, "", f"more than {MAX_ROWS} rows"))
                break
    except csv.Error as error:
        problems.append(TableProblem(lines.line_num, "", f"this is not CSV: {error}"))
    return Table(columns, tuple(rows), tuple(problems))


def format_table(rows: Iterable[DatasetRow], columns: Sequence[str] = COLUMNS) -> str:
    """Write rows as text, one line each.

    Cells whose value is as it was read keep their text; other numbers get 0.1 mm and 0.01 degrees.

    Parameters
    ----------
    rows
        In the order in which they are to stand.
    columns
        As the table had them; columns that a row needs beside these are added.
    """
    rows = list(rows)
    names = list(dict.fromkeys(columns))
    needed = [
        name for row in rows for name, value in row.values().items() if value not in ("", None)
    ]
    names += [name for name in dict.fromkeys(needed) if name not in names]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(names)
    for row in rows:
        cells = _cells(row)
        # Not all versions of csv quote a lone carriage return.
        table.writerow([cells.get(name, "").replace("\r", "\n") for name in names])
    return text.getvalue()


def check_file_name(name: str) -> str:
    """Say what is wrong with a recording's name in the table; empty if nothing is.

    A name that leads out of the folder, as ``../x`` or ``/x`` do, is wrong.
    """
    parts = name.split("/")
    if not name:
        return "file_name is blank: expected a recording's path in this folder"
    if _CONTROL.search(name) or "\\" in name:
        return f"file_name {name!r}, expected folders and names with / between them"
    if name.startswith("/") or ".." in parts or ":" in parts[0]:
        return f"file_name {name!r} leads out of the folder: expected a path inside it"
    if "" in parts or "." in parts:
        return f"file_name {name!r}, expected a plain path such as garage/s1/0001_r48.mcap"
    return ""


def _wrong_columns(columns: tuple[str, ...]) -> list[str]:
    if not columns or columns == ("",):
        return [f"the table is empty, expected a first line {','.join(COLUMNS)}"]
    if len(columns) == 1 and ";" in columns[0]:
        return ["columns are separated by ';', expected ',': export it again with commas"]
    wrong = []
    if columns[0] != "file_name":
        wrong.append(f"first column is {columns[0]!r}, expected 'file_name'")
    if "label" not in columns:
        near = get_close_matches("label", columns, 1)
        hint = f"; is it {near[0]!r}?" if near else ""
        wrong.append(f"no column 'label'{hint}")
    for name in dict.fromkeys(columns):
        if columns.count(name) > 1:
            wrong.append(f"{columns.count(name)} columns are called {name!r}: rename or remove")
    return wrong


def _read_row(
    columns: tuple[str, ...], cells: list[str], line: int
) -> tuple[DatasetRow | None, list[str]]:
    if len(cells) != len(columns):
        return None, [f"{len(cells)} cells, expected {len(columns)} as in the first line"]
    if any(len(cell) > MAX_CELL_CHARACTERS for cell in cells):
        return None, [f"a cell of more than {MAX_CELL_CHARACTERS} characters"]
    texts = dict(zip(columns, cells, strict=True))
    known = {name: texts.get(name, "").strip() for name in COLUMNS}
    wrong = [check_file_name(known["file_name"])]
    if not known["label"] or _CONTROL.search(known["label"]):
        wrong.append(f"label {known['label']!r}, expected r35 and the like, or none")
    if known["sha256"] and not _SHA256.fullmatch(known["sha256"]):
        wrong.append(f"sha256 {known['sha256']!r}, expected 64 hexadecimal digits or nothing")
    numbers = {}
    for name in NUMBER_COLUMNS:
        try:
            numbers[name] = _PARSERS[name](known[name])
        except ValueError as error:
            wrong.append(f"{name} {known[name]!r}, expected {error}")
    wrong = [said for said in wrong if said]
    if wrong:
        return None, wrong
    row = DatasetRow(
        file_name=known["file_name"],
        label=known["label"],
        range_m=numbers["range_m"],
        azimuth_rad=numbers["azimuth_deg"],
        yaw_rad=numbers["yaw_deg"],
        environment=known["environment"],
        session=known["session"],
        operator=known["operator"],
        sha256=known["sha256"],
        quality=known["quality"],
        extra={name: text for name, text in texts.items() if name not in COLUMNS},
        line=line,
        cells=texts,
    )
    return row, []


def parse_range_m(text: str) -> float:
    """Read a range in m; NaN for nothing.

    Raises
    ------
    ValueError
        With what was expected.
    """
    value = _number(text, "metres")
    if value <= 0 or value > 100:
        raise ValueError("metres above 0 and up to 100")
    return value


def parse_angle_rad(text: str) -> float:
    """Read an angle in degrees, as rad; NaN for nothing.

    Raises
    ------
    ValueError
        With what was expected.
    """
    value = _number(text, "degrees")
    if abs(value) > 180:
        raise ValueError("degrees from -180 to 180")
    return math.radians(value)


def _number(text: str, unit: str) -> float:
    if not text.strip():
        return _NAN
    try:
        value = float(text)
    except ValueError:
        hint = " with a decimal point" if "," in text else ", or nothing"
        raise ValueError(f"a number of {unit}{hint}") from None
    if not math.isfinite(value) or "_" in text:
        raise ValueError(f"a finite number of {unit}, or nothing")
    return value


_PARSERS: dict[str, Callable[[str], float]] = {
    "range_m": parse_range_m,
    "azimuth_deg": parse_angle_rad,
    "yaw_deg": parse_angle_rad,
}


def range_text(range_m: float) -> str:
    """Text of a range, m, to 0.1 mm; nothing for NaN."""
    return "" if math.isnan(range_m) else f"{range_m:.4f}"


def angle_text(angle_rad: float) -> str:
    """Text of an angle, in degrees to 0.01; nothing for NaN."""
    text = f"{math.degrees(angle_rad):.2f}"
    return {"nan": "", "-0.00": "0.00"}.get(text, text)


def _cells(row: DatasetRow) -> dict[str, str]:
    cells = {name: "" if value is None else value for name, value in row.values().items()}
    cells["range_m"] = range_text(row.range_m)
    cells["azimuth_deg"] = angle_text(row.azimuth_rad)
    cells["yaw_deg"] = angle_text(row.yaw_rad)
    for name, value in zip(
        NUMBER_COLUMNS, (row.range_m, row.azimuth_rad, row.yaw_rad), strict=True
    ):
        before = row.cells.get(name, "")
        if before and _PARSERS[name](before) == value:
            cells[name] = before
    return cells


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
