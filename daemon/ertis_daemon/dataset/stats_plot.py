"""A data set at a glance: where its pings lie, and how many of each class."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ertis_driver.dataset import NONE, Dataset
from ertis_driver.errors import DatasetError

_COLORS = ("#4477aa", "#66ccee", "#228833", "#ccbb44", "#ee6677", "#aa3377")
_GREY = "#bbbbbb"


def draw_statistics(dataset: Dataset, told: dict[str, Any], path: Path) -> None:
    """Draw what ``statistics`` tells.

    Raises
    ------
    DatasetError
        If matplotlib is not installed, or the picture cannot be written.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise DatasetError("--plot needs matplotlib: pip install 'ertis[plot]'") from error
    labels = sorted(told["labels"], key=lambda label: (label == NONE, label))
    colors = {label: _COLORS[at % len(_COLORS)] for at, label in enumerate(labels)}
    colors[NONE] = _GREY
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    bars, plan, ranges, turns = figure.subplots(2, 2).ravel()
    kinds = {("sim",): "simulated ", ("live",): "", ("replay",): "replayed "}
    kind = kinds.get(tuple(told["sources"]), "")
    figure.suptitle(
        f"{dataset.folder.name}: {told['pings']} {kind}pings, manifest {told['manifest_hash'][:12]}"
    )
    _bars(bars, told, labels, colors)
    _plan(plan, dataset, labels, colors)
    for axes, name, bins in (
        (ranges, "range_m", np.arange(0, 7, 0.25)),
        (turns, "yaw_deg", np.arange(-90, 91, 7.5)),
    ):
        values = [
            [
                v
                for row in dataset.rows
                if row.label == label and (v := row.values()[name]) is not None
            ]
            for label in labels
        ]
        axes.hist(values, bins, stacked=True, color=[colors[label] for label in labels])
        axes.set_ylabel("pings")
    ranges.set_xlabel("range (m)")
    turns.set_xlabel("turn of the dish (degrees)")
    try:
        figure.savefig(path, dpi=110)
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot write {path}: {error}") from error


def _bars(axes: Any, told: dict[str, Any], labels: list[str], colors: dict[str, str]) -> None:
    names = list(told["counts"])
    base = np.zeros(len(names))
    for label in labels:
        counts = np.array([told["counts"][name][label] for name in names])
        axes.barh(names, counts, left=base, color=colors[label], label=label)
        base += counts
    axes.invert_yaxis()
    axes.set_xlabel("pings")
    axes.legend(ncols=len(labels), fontsize="small", loc="lower left", bbox_to_anchor=(0, 1))


def _plan(axes: Any, dataset: Dataset, labels: list[str], colors: dict[str, str]) -> None:
    for label in labels:
        rows = [row for row in dataset.rows if row.label == label]
        x = [row.range_m * math.cos(row.azimuth_rad) for row in rows]
        y = [row.range_m * math.sin(row.azimuth_rad) for row in rows]
        axes.plot(y, x, ".", color=colors[label], markersize=4)
    axes.plot(0, 0, "k^")
    axes.set_aspect("equal")
    axes.invert_xaxis()  # + is left
    axes.set_xlabel("left of the sonar (m)")
    axes.set_ylabel("before the sonar (m)")
