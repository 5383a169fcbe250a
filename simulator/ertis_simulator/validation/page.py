"""The validation page: prose is written by hand, every table between markers by this."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ertis_simulator.errors import SceneError
from ertis_simulator.validation.check import HEADER, Check, as_row
from ertis_simulator.validation.real_ping import Row

_ROW_HEADER = "| what | real | simulated | difference | held to |\n|---|---|---|---|---|"


def checks_table(checks: Sequence[Check]) -> str:
    """Markdown table of checks."""
    return "\n".join([HEADER, *map(as_row, checks)])


def rows_table(rows: Sequence[Row]) -> str:
    """Markdown table of real against simulated."""
    lines = [_ROW_HEADER]
    for row in rows:
        held = "told only" if row.allowed is None else f"{row.allowed:g}"
        lines.append(
            f"| {row.what} | {_number(row.real)} {row.unit} | {_number(row.simulated)} {row.unit} "
            f"| {_number(row.difference, '+')} | {held} |"
        )
    return "\n".join(lines)


def _number(value: float, sign: str = "") -> str:
    return f"{value:{sign}.0f}" if abs(value) >= 150 else f"{value:{sign}.3g}"


def fill(page: str, name: str, table: str) -> str:
    """The page with what stands between ``<!-- name -->`` and ``<!-- end name -->`` replaced.

    Raises
    ------
    SceneError
        If the page has no such pair of markers.
    """
    begin, end = f"<!-- {name} -->", f"<!-- end {name} -->"
    pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
    if not pattern.search(page):
        raise SceneError(
            f"the page has no markers {begin} and {end}: put them where the table goes"
        )
    return pattern.sub(lambda _: f"{begin}\n{table}\n{end}", page)
