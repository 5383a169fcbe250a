"""What the bound says of one data set: each landmark at its own tilt and signal-to-clutter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ertis_driver.recording import read_recording
from ertis_simulator.bound.table import SizeBound
from ertis_simulator.errors import SceneError

Float = npt.NDArray[np.float64]


class Landmarks(NamedTuple):
    """The labelled landmarks of a data set; each array of shape (n,).

    label, range_m, azimuth_deg, tilt_deg
    ratio_db : signal-to-clutter at one microphone; NaN where nothing of it is heard
    """

    label: tuple[str, ...]
    range_m: Float
    azimuth_deg: Float
    tilt_deg: Float
    ratio_db: Float


class Expected(NamedTuple):
    """Means over landmarks; one that is not heard counts as guessed.

    told, level, free, detected : as of ``SizeBound``
    """

    told: float
    level: float
    free: float
    detected: float


def read_landmarks(folder: Path) -> Landmarks:
    """Truth of every recording in a simulated data set that has a landmark.

    Raises
    ------
    SceneError
        If there is none.
    """
    rows = []
    for path in sorted(folder.rglob("*.mcap")):
        truth = next(iter(read_recording(path))).truth or {}
        for line in truth.get("landmarks", [])[:1]:
            ratio = line.get("own_to_rest_db")
            rows.append(
                (
                    line["label"],
                    line["range_m"],
                    abs(np.rad2deg(line["azimuth_rad"])),
                    np.rad2deg(line["tilt_rad"]),
                    np.nan if ratio is None else ratio,
                )
            )
    if not rows:
        raise SceneError(f"{folder}: no simulated landmark in it, expected a data set of them")
    label, *numbers = zip(*rows, strict=True)
    return Landmarks(label, *(np.array(one, float) for one in numbers))


def look_up(rows: Sequence[SizeBound], kind: str, heard: Landmarks) -> Float:
    """The bound at each landmark, shape (n, 4): told, level, free, detected.

    Nearest range and azimuth, between ratios and tilts in a straight line; beyond the table's ends
    as at the ends.
    """
    table = [row for row in rows if row.receiver == kind]
    ranges, azimuths, tilts, ratios = (
        np.unique([getattr(row, name) for row in table])
        for name in ("range_m", "azimuth_deg", "tilt_deg", "ratio_db")
    )
    shape = (ranges.size, azimuths.size, tilts.size, ratios.size)
    grid = np.full((*shape, 4), np.nan)
    for row in table:
        at = (
            np.searchsorted(ranges, row.range_m),
            np.searchsorted(azimuths, row.azimuth_deg),
            np.searchsorted(tilts, row.tilt_deg),
            np.searchsorted(ratios, row.ratio_db),
        )
        grid[at] = row.told, row.level, row.free, row.detected
    near = np.abs(np.log(heard.range_m[:, None] / ranges)).argmin(axis=1)
    aside = np.abs(heard.azimuth_deg[:, None] - azimuths).argmin(axis=1)
    tilt, tilt_share = _between(tilts, heard.tilt_deg)
    ratio, ratio_share = _between(ratios, np.nan_to_num(heard.ratio_db, nan=-np.inf))
    found = np.zeros((len(heard.label), 4))
    for step_t, share_t in ((0, 1 - tilt_share), (1, tilt_share)):
        for step_r, share_r in ((0, 1 - ratio_share), (1, ratio_share)):
            found += (share_t * share_r)[:, None] * grid[near, aside, tilt + step_t, ratio + step_r]
    found[np.isnan(heard.ratio_db)] = 0.25, 0.25, 0.25, 0.0
    return found


def _between(grid: Float, value: Float) -> tuple[npt.NDArray[np.intp], Float]:
    inside = np.clip(value, grid[0], grid[-1])
    lower = np.clip(np.searchsorted(grid, inside, side="right") - 1, 0, grid.size - 2)
    return lower, (inside - grid[lower]) / (grid[lower + 1] - grid[lower])


def expected(rows: Sequence[SizeBound], kind: str, heard: Landmarks) -> Expected:
    """Mean of ``look_up`` over all landmarks."""
    return Expected(*(float(one) for one in look_up(rows, kind, heard).mean(axis=0)))
