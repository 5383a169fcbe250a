"""Figures as SVG text that goes into a page: the same figures are the same bytes."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_driver.errors import ErtisError

Float = npt.NDArray[np.float64]
COLOURS = ("#2a6fb0", "#c8501e", "#3a8f5c", "#7a4ea3")
_STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "ertis",
}


def svg(
    paint: Callable[[Any], None],
    width_in: float,
    height_in: float,
    *,
    rows: int = 1,
    columns: int = 1,
) -> str:
    """Let ``paint`` draw on an array of axes (rows, columns); returns one ``<svg>`` element.

    Raises
    ------
    ErtisError
        If matplotlib is missing.
    """
    try:
        import matplotlib as mpl
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ErtisError("--html needs matplotlib: pip install 'ertis[plot]'") from error
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        paint(figure.subplots(rows, columns, squeeze=False))
        text = io.StringIO()
        # The kind of file only: no version, no date.
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    drawn = text.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    return re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)


def confusion(axis: Any, counts: Float, names: Sequence[str], title: str) -> None:
    """Counts with truth down; shaded by the share of each row."""
    rows = np.maximum(counts.sum(axis=1, keepdims=True), 1e-9)
    share = counts / rows
    edges = np.arange(len(names) + 1) - 0.5
    # Cells as shapes: an image would be pixels inside the page.
    axis.pcolormesh(edges, edges, share, cmap="Blues", vmin=0, vmax=1)
    axis.invert_yaxis()
    axis.set_aspect("equal")
    for i in range(len(names)):
        for j in range(len(names)):
            axis.text(
                j,
                i,
                f"{100 * share[i, j]:.0f} %\n{counts[i, j]:.0f}",
                ha="center",
                va="center",
                fontsize=8,
                color="white" if share[i, j] > 0.6 else "black",
            )
    ticks = np.arange(len(names))
    axis.set(title=title, xlabel="said", ylabel="is", xticks=ticks, yticks=ticks)
    axis.set_xticklabels(names)
    axis.set_yticklabels(names)
    axis.grid(visible=False)
    axis.tick_params(length=0)


def with_interval(
    axis: Any,
    x: Sequence[float],
    mean: Sequence[float],
    intervals: Sequence[tuple[float, float]],
    **style: Any,
) -> None:
    """Points with their intervals; what is NaN is left out."""
    middle = np.asarray(mean, float)
    ends = np.asarray(intervals, float).reshape(-1, 2)
    drawn = ~np.isnan(middle)
    below = np.nan_to_num(np.maximum(middle - ends[:, 0], 0))
    above = np.nan_to_num(np.maximum(ends[:, 1] - middle, 0))
    axis.errorbar(
        np.asarray(x, float)[drawn],
        middle[drawn],
        np.array([below[drawn], above[drawn]]),
        fmt="o",
        ms=5,
        capsize=2.5,
        lw=1.2,
        **style,
    )
