"""How much of what a data set holds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ertis_driver.dataset import NONE, Dataset, DatasetRow
from ertis_driver.errors import DatasetError, RecordingError
from ertis_driver.recording import read_recording


def statistics(dataset: Dataset) -> dict[str, Any]:
    """Count pings by environment, class, session and quality, and say where they lie."""
    rows = dataset.rows
    labels = sorted({row.label for row in rows})
    environments = sorted({row.environment for row in rows})
    counts = Counter((row.environment, row.label) for row in rows)
    return {
        "folder": str(dataset.folder),
        "manifest_hash": dataset.manifest_hash,
        "sources": sources(dataset),
        "pings": len(rows),
        "sessions": len({(row.environment, row.session) for row in rows}),
        "counts": {
            environment: {label: counts[environment, label] for label in labels}
            for environment in environments
        },
        "labels": dict(Counter(row.label for row in rows)),
        "qualities": dict(Counter(row.quality or "not told" for row in rows)),
        "operators": dict(Counter(row.operator or "not told" for row in rows)),
        "range_m": _spread(rows, lambda row: row.range_m),
        "azimuth_deg": _spread(rows, lambda row: math.degrees(row.azimuth_rad)),
        "yaw_deg": _spread(rows, lambda row: math.degrees(row.yaw_rad)),
    }


def sources(dataset: Dataset) -> list[str]:
    """Who made the frames, told by one recording of each session; empty if none can be read."""
    firsts = {(row.environment, row.session): row for row in reversed(dataset.rows)}
    found = set()
    for row in firsts.values():
        try:
            found.add(read_recording(dataset.path(row)).info.source)
        except (DatasetError, RecordingError):
            continue
    return sorted(found)


def _spread(rows: Sequence[DatasetRow], value: Callable[[DatasetRow], float]) -> dict[str, Any]:
    known = np.array([value(row) for row in rows if not math.isnan(value(row))])
    if not known.size:
        return {"known": 0}
    low, middle, high = (round(float(v), 3) for v in np.percentile(known, [0, 50, 100]))
    return {"known": int(known.size), "least": low, "median": middle, "most": high}


def as_lines(told: dict[str, Any]) -> list[str]:
    """Statistics as a table for people."""
    labels = sorted(told["labels"], key=lambda label: (label == NONE, label))
    simulated = " simulated" if told["sources"] == ["sim"] else ""
    if "sim" in told["sources"] and not simulated:
        simulated = " partly simulated"
    width = max([11, *(len(name) for name in told["counts"])])
    lines = [
        f"{told['pings']}{simulated} pings in {told['sessions']} sessions, "
        f"manifest {told['manifest_hash'][:12]}",
        "",
        " ".join(["environment".ljust(width), *(f"{label:>6}" for label in labels), "   all"]),
    ]
    for name, counts in told["counts"].items():
        numbers = [counts[label] for label in labels]
        cells = [f"{number:6d}" for number in [*numbers, sum(numbers)]]
        lines.append(" ".join([(name or "-").ljust(width), *cells]))
    totals = [told["labels"][label] for label in labels]
    lines.append(" ".join(["all".ljust(width), *(f"{n:6d}" for n in [*totals, sum(totals)])]))
    lines.append("")
    for name in ("range_m", "azimuth_deg", "yaw_deg"):
        spread = told[name]
        if spread["known"]:
            lines.append(
                f"{name:<12} {spread['least']:g} to {spread['most']:g}, median "
                f"{spread['median']:g}, known of {spread['known']}"
            )
    each = ", ".join(f"{count} {name}" for name, count in sorted(told["qualities"].items()))
    lines.append(f"{'quality':<12} {each}")
    return lines
