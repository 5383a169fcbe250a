"""How often a detector is right and wrong: what the tracker needs to know of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from ertis_detector.false_tracks import FalseTracks

S_PER_HOUR = 3600.0
# Two thousand pings without one false alarm say no more than this (95 %, Poisson).
_LEAST_FALSE_ALARMS = 1.5e-3
_LEAST_CLUTTER = 0.1


@dataclass(frozen=True, slots=True)
class DetectorRates:
    """Figures of a detector, as its model's card gives them; the defaults are cautious.

    false_alarms_per_ping : float
        Reports of what is no landmark: clutter, bowls and lampshades.
    precision : float
        Part of all reports that are landmarks, in the data that the probabilities were
        calibrated on.
    found : float
        Part of landmarks in sight that one ping reports.
    clutter_per_ping : float
        Echoes a ping that are no landmark and might have been reported.
    false_tracks : FalseTracks or None
        What drives without a landmark gave; None if nobody drove.
    """

    false_alarms_per_ping: float = 0.2
    precision: float = 0.7
    found: float = 0.5
    clutter_per_ping: float = 4.0
    false_tracks: FalseTracks | None = None

    @classmethod
    def from_figures(cls, figures: Mapping[str, float]) -> DetectorRates:
        """Read a model card's figures; what it lacks, or says nonsense of, keeps its default.

        Clutter a ping follows from the reports: (1 - precision) of them are the false alarms.
        """
        own = cls()
        alarms = _figure(figures, "false_alarms_per_ping")
        precision = _figure(figures, "precision", 1.0)
        found = _figure(figures, "found", 1.0)
        landmarks = _figure(figures, "landmark_proposals")
        clutter = _figure(figures, "proposals") - landmarks
        false = found * landmarks * (1.0 - precision) / max(precision, 1e-9)
        per_ping = alarms * clutter / false if false > 0 else math.nan
        return cls(
            _known(max(alarms, _LEAST_FALSE_ALARMS), own.false_alarms_per_ping),
            _known(min(max(precision, 0.05), 0.999), own.precision),
            _known(min(max(found, 0.05), 0.99), own.found),
            _known(max(per_ping, _LEAST_CLUTTER), own.clutter_per_ping),
            FalseTracks.from_figures(figures),
        )

    @property
    def chance(self) -> float:
        """Probability that an echo of something else is reported, below that of a landmark."""
        return min(self.false_alarms_per_ping / self.clutter_per_ping, 0.9 * self.found)


def _figure(figures: Mapping[str, float], name: str, high: float = math.inf) -> float:
    """NaN if it is missing or no such figure; NaN stays NaN in max(NaN, x), the first of equals."""
    value = figures.get(name, math.nan)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and 0.0 <= value <= high and value < math.inf else math.nan


def _known(value: float, default: float) -> float:
    return default if math.isnan(value) else value
