"""The strongest reflectors of a ping in three dimensions: for people, and to check a sonar by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ertis_detector.imaging import Complex, Energyscape, Imager, plane
from ertis_detector.locate import locate
from ertis_detector.proposals import propose
from ertis_detector.scanner import Scanner

_ELEVATIONS_RAD = np.deg2rad(np.arange(-40.0, 41.0, 10.0))
_MIN_LEVEL_DB = 6.0


@dataclass(frozen=True, slots=True)
class Reflector:
    """A distinct peak of the image; level over the noise floor, dB."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float
    level_db: float


def strongest(
    scanner: Scanner, baseband: Complex, scape: Energyscape, count: int
) -> list[Reflector]:
    """Up to ``count`` reflectors, strongest first.

    Parameters
    ----------
    scanner : Scanner
    baseband, scape
        As ``scanner.image`` returns them.
    count : int
    """
    azimuth, _ = plane()
    focus = scanner.focus
    imager = Imager(
        focus.mics,
        focus.info,
        focus.c,
        np.tile(azimuth, _ELEVATIONS_RAD.size),
        np.repeat(_ELEVATIONS_RAD, azimuth.size),
    )
    found = propose(imager(baseband), max_count=count, min_snr_db=_MIN_LEVEL_DB, range_exponent=0.0)
    floor = scape.noise_floor
    reflectors = [
        Reflector(
            at.range_m,
            at.azimuth_rad,
            at.elevation_rad,
            float(10 * np.log10(max(at.power, floor) / floor)),
        )
        for at in locate(focus, baseband, found)
    ]
    return sorted(reflectors, key=lambda one: -one.level_db)
