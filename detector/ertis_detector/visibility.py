"""How probably a landmark at some place is reported: what silence there is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ertis_detector.motion import Float
from ertis_detector.piston import piston_pattern
from ertis_detector.rates import DetectorRates

_WAVENUMBER = 2 * math.pi * 50e3 / 343.0  # rad/m, where transducer and microphones peak
_ABSORPTION_DB_PER_M = 1.66  # there, one way, 20 degrees Celsius and 50 % (ISO 9613-1)
_HALF_HEARD_DB, _SLOPE_DB = 14.0, 3.0  # level over the noise floor at which every second is heard
_LEAST, _MOST = 0.02, 0.98
_EDGE = np.array([0.1, math.radians(2.0), math.radians(2.0)])  # so near an edge, it may be missed


@dataclass(frozen=True, slots=True)
class FieldOfView:
    """Where the detector reports landmarks."""

    min_range_m: float = 0.6
    max_range_m: float = 4.6
    max_azimuth_rad: float = math.radians(30.0)
    max_elevation_rad: float = math.radians(12.0)

    @property
    def volume(self) -> float:
        """Of range, azimuth and elevation, m rad2: over it false alarms are spread."""
        across = 4 * self.max_azimuth_rad * self.max_elevation_rad
        return (self.max_range_m - self.min_range_m) * across

    def holds(self, seen: Float) -> bool:
        """Whether a place (range, azimuth, elevation) is inside, by more than the edge's width."""
        range_m, azimuth, elevation = seen
        return bool(
            self.min_range_m + _EDGE[0] < range_m < self.max_range_m - _EDGE[0]
            and abs(azimuth) < self.max_azimuth_rad - _EDGE[1]
            and abs(elevation) < self.max_elevation_rad - _EDGE[2]
        )


def level_change_db(before: Float, now: Float) -> float:
    """By how much one echo's level changes between two places, (range, azimuth, elevation) each.

    Spherical spreading there and back, absorption, and the emitter's beam.
    """
    spreading = 40.0 * math.log10(before[0] / max(now[0], 1e-3))
    absorbed = 2.0 * _ABSORPTION_DB_PER_M * (before[0] - now[0])
    off_axis = [1.0 - (math.cos(a) * math.cos(e)) ** 2 for _, a, e in (before, now)]
    beam = np.abs(piston_pattern(np.array(_WAVENUMBER), np.sqrt(np.array(off_axis))))
    return float(spreading + absorbed + 20.0 * np.log10((beam[1] + 1e-2) / (beam[0] + 1e-2)))


def detectable(rates: DetectorRates, level_db: float) -> float:
    """Probability that a landmark in view is reported, its echo that far over the noise floor.

    No better than the model's average, which holds for dishes turned away, too.
    """
    heard = 1.0 / (1.0 + math.exp(-(level_db - _HALF_HEARD_DB) / _SLOPE_DB))
    return min(max(rates.found * heard, _LEAST), _MOST)
