"""A ping as a picture: its energyscape from above, with what was found in it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ertis_detector.imaging import Energyscape
from ertis_detector.reflectors import Reflector
from ertis_driver.errors import ErtisError

SPAN_DB = 45.0
_WIDENED_CELLS = 7


def draw(
    scape: Energyscape,
    landmarks: Sequence[tuple[str, float, float]],
    reflectors: Sequence[Reflector],
    title: str,
    path: Path,
) -> None:
    """Draw one energyscape to a PNG, SVG or PDF file.

    Parameters
    ----------
    scape : Energyscape
    landmarks : of (text, range_m, azimuth_rad)
    reflectors : drawn as small crosses
    title : str
        Says who made the ping: a simulated one must be called so.
    path : Path

    Raises
    ------
    ErtisError
        If matplotlib is missing or the file cannot be written.
    """
    figure = new_figure(8.4, 5.4)
    axes = figure.subplots()
    paint(figure, axes, scape)
    for spot in reflectors:
        across, ahead = _plan(spot.range_m, spot.azimuth_rad)
        axes.plot(across, ahead, "+", color="cyan", markersize=9)
    for text, range_m, azimuth_rad in landmarks:
        across, ahead = _plan(range_m, azimuth_rad)
        axes.plot(across, ahead, "o", fillstyle="none", color="lime", markersize=14)
        axes.annotate(text, (across, ahead), (9, 9), textcoords="offset points", color="lime")
    axes.set_title(title)
    save(figure, path)


def new_figure(width_in: float, height_in: float) -> Any:
    """Make an empty figure without a display.

    Raises
    ------
    ErtisError
        If matplotlib is missing.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ErtisError("--plot needs matplotlib: pip install 'ertis[plot]'") from error
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def paint(figure: Any, axes: Any, scape: Energyscape) -> None:
    """Paint an energyscape seen from above, left on the left, with its scale."""
    # An echo is a line 6 mm thin: widened to 4 cm, or a screen shows nothing of it.
    wide = np.lib.stride_tricks.sliding_window_view(scape.power, _WIDENED_CELLS, axis=1).max(axis=2)
    ranges_m = scape.range_m[_WIDENED_CELLS // 2 :][: wide.shape[1]]
    level_db = 10 * np.log10(np.maximum(wide / scape.noise_floor, 1e-3))
    forward = np.outer(np.cos(scape.azimuth_rad), ranges_m)
    left = np.outer(np.sin(scape.azimuth_rad), ranges_m)
    mesh = axes.pcolormesh(
        left, forward, level_db, vmin=0, vmax=SPAN_DB, cmap="magma", shading="gouraud"
    )
    figure.colorbar(mesh, label="level over the noise floor (dB)", shrink=0.9)
    axes.set_facecolor("black")
    axes.set_aspect("equal")
    axes.invert_xaxis()  # left on the left, as the sonar sees it
    axes.set(xlabel="left (m)", ylabel="forward (m)")


def save(figure: Any, path: Path) -> None:
    """Write a figure to a PNG, SVG or PDF file.

    Raises
    ------
    ErtisError
        If it cannot be written.
    """
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise ErtisError(f"cannot write picture {path}: {error}") from error


def _plan(range_m: float, azimuth_rad: float) -> tuple[float, float]:
    return float(range_m * np.sin(azimuth_rad)), float(range_m * np.cos(azimuth_rad))
