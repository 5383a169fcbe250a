"""One figure against another, with what it was held against and how far apart they may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Check:
    """A figure of the simulator and the one it must agree with.

    what : str
        What was measured.
    source : str
        Where ``expected`` comes from.
    expected, found, allowed : float
        In ``unit``; they agree if they differ by ``allowed`` at most.
    """

    what: str
    source: str
    expected: float
    found: float
    allowed: float
    unit: str

    @property
    def difference(self) -> float:
        """Found minus expected."""
        return self.found - self.expected

    @property
    def agrees(self) -> bool:
        """Whether the two are near enough; NaN never is."""
        return abs(self.difference) <= self.allowed


HEADER = (
    "| what | expected | found | difference | allowed | expected from |\n|---|---|---|---|---|---|"
)


def as_row(check: Check) -> str:
    """The check as a row of a Markdown table under ``HEADER``."""
    cells = [
        check.what,
        f"{_rounded(check.expected)} {check.unit}",
        f"{_rounded(check.found)} {check.unit}",
        f"{check.difference:+.2g}",
        f"{check.allowed:.2g}" + ("" if check.agrees else " **exceeded**"),
        check.source,
    ]
    return "| " + " | ".join(cells) + " |"


def _rounded(value: float) -> str:
    return f"{value:.5g}" if abs(value) >= 100 else f"{value:.4g}"
