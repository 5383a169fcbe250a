"""The bound as a table: made, written, read, and looked up."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from ertis_simulator.bound.fisher import place_bound
from ertis_simulator.bound.sizes import hypotheses, one_side, score
from ertis_simulator.bound.templates import receiver
from ertis_simulator.errors import SceneError
from ertis_simulator.landmark import RADII_MM

BEAM, ARRAY = "beam", "array"
RANGES_M = (1.0, 2.0, 4.0)
AZIMUTHS_DEG = (0.0, 20.0)
RATIOS_DB = (-20.0, -15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 20.0)


@dataclass(frozen=True, slots=True)
class SizeBound:
    """One row; shares of trials over all sizes.

    receiver : ``beam`` or ``array``
    range_m, azimuth_deg, tilt_deg, ratio_db : float
    told, level, free : right sizes where level and range, the level, nothing is known
    detected : at one false alarm in a thousand fragments
    trials : int
    """

    receiver: str
    range_m: float
    azimuth_deg: float
    tilt_deg: float
    ratio_db: float
    told: float
    level: float
    free: float
    detected: float
    trials: int


@dataclass(frozen=True, slots=True)
class PlaceRow:
    """Cramer-Rao bounds at a signal-to-clutter of 0 dB at one microphone."""

    range_m: float
    azimuth_deg: float
    radius_mm: int
    tilt_deg: float
    range_mm: float
    own_azimuth_deg: float
    elevation_deg: float
    own_tilt_deg: float


def size_rows(
    trials: int,
    seed: int,
    *,
    receivers: Sequence[str] = (BEAM, ARRAY),
    ranges_m: Sequence[float] = RANGES_M,
    azimuths_deg: Sequence[float] = AZIMUTHS_DEG,
    ratios_db: Sequence[float] = RATIOS_DB,
    progress: Callable[[str], None] = lambda text: None,
) -> Iterator[SizeBound]:
    """Try the best receiver everywhere; ``trials`` of each size at each tilt and ratio."""
    rng = np.random.default_rng(seed)
    for kind in receivers:
        for range_m in ranges_m:
            for azimuth_deg in azimuths_deg:
                progress(f"{kind}, {range_m:g} m, {azimuth_deg:g} degrees aside")
                yield from _at_place(kind, range_m, azimuth_deg, ratios_db, trials, rng)


def _at_place(
    kind: str,
    range_m: float,
    azimuth_deg: float,
    ratios_db: Sequence[float],
    trials: int,
    rng: np.random.Generator,
) -> Iterator[SizeBound]:
    ear = receiver(range_m, azimuth_deg, one_beam=kind == BEAM)
    all_of = hypotheses(ear)
    which = one_side(all_of)
    scores = score(ear, all_of, which, ratios_db, trials, rng)
    # By size, then tilt: the mean over sizes is what the row tells.
    shape = (len(RADII_MM), -1, len(ratios_db))
    right = scores.right.reshape(len(scores.right), *shape).mean(axis=1)
    detected = scores.detected.reshape(shape).mean(axis=0)
    tilts_deg = np.rad2deg(all_of.tilt_rad[which]).reshape(len(RADII_MM), -1)[0]
    for row, tilt_deg in enumerate(tilts_deg):
        for column, ratio_db in enumerate(ratios_db):
            told, level, free = (float(one) for one in right[:, row, column])
            yield SizeBound(
                kind,
                range_m,
                azimuth_deg,
                round(float(tilt_deg), 1),
                ratio_db,
                round(told, 4),
                round(level, 4),
                round(free, 4),
                round(float(detected[row, column]), 4),
                trials * len(RADII_MM),
            )


def place_rows(
    *, ranges_m: Sequence[float] = RANGES_M, azimuths_deg: Sequence[float] = AZIMUTHS_DEG
) -> Iterator[PlaceRow]:
    """Cramer-Rao bounds of every size at some tilts."""
    for range_m in ranges_m:
        for azimuth_deg in azimuths_deg:
            ear = receiver(range_m, azimuth_deg, one_beam=False)
            for radius_mm in RADII_MM:
                for tilt_deg in (5.0, 15.0, 25.0, 35.0, 45.0, 55.0):
                    found = place_bound(ear, radius_mm, float(np.deg2rad(tilt_deg)))
                    degrees = np.rad2deg([found.azimuth_rad, found.elevation_rad, found.tilt_rad])
                    yield PlaceRow(
                        range_m,
                        azimuth_deg,
                        radius_mm,
                        tilt_deg,
                        round(found.range_m * 1e3, 4),
                        *(round(float(one), 4) for one in degrees),
                    )


def write_rows(path: Path, rows: Sequence[SizeBound] | Sequence[PlaceRow]) -> None:
    """Write rows as CSV."""
    text = io.StringIO()
    table = csv.DictWriter(text, [one.name for one in fields(rows[0])], lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(row) for row in rows)
    path.write_text(text.getvalue(), encoding="utf-8")


def read_sizes(path: Path) -> list[SizeBound]:
    """Rows that ``write_rows`` wrote.

    Raises
    ------
    SceneError
        If the file holds anything else.
    """
    names = [one.name for one in fields(SizeBound)]
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        return [
            SizeBound(
                row["receiver"],
                **{name: float(row[name]) for name in names[1:-1]},
                trials=int(row["trials"]),
            )
            for row in rows
        ]
    except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError) as error:
        raise SceneError(
            f"{path}: {error!r}, expected a table with columns {','.join(names)}: make it again "
            "with python -m ertis_simulator.bound"
        ) from error
