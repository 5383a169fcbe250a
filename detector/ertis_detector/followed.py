"""One thing followed over pings: where it is, what it is, and how long it was silent."""

from __future__ import annotations

import math

from ertis_detector.detection import Detection
from ertis_detector.evidence import Evidence
from ertis_detector.motion import Float, Motion
from ertis_detector.place import GATE, Measured, Place
from ertis_detector.rates import DetectorRates
from ertis_detector.views import View
from ertis_detector.visibility import FieldOfView, detectable, level_change_db

_LEAST_LIKENESS = 0.05  # of sizes: a ping may mishear
_NEW_PER_PING = 0.02  # landmarks that come into view; assumed


class Followed:
    """A landmark, or what may turn out to be none.

    track_id : int or None
        None until it is announced.
    label : str
        Size it was announced with.
    """

    def __init__(self, detection: Detection, time_ns: int, rates: DetectorRates) -> None:
        self.track_id: int | None = None
        self.label = ""
        self.heard_ns = time_ns
        self.silence = 0.0  # log-probability of hearing nothing since
        self.reported: Detection | None = None
        self._rates = rates
        self._latest = detection
        self.place = Place(Measured(detection))
        self._latest_place = self.place.seen
        self._reported: tuple[Detection | None, Float | None, float] = None, None, 0.0
        self._view = View(detection.range_m, detection.azimuth_rad)
        self.evidence = Evidence(rates, tuple(detection.probabilities))
        self.evidence.heard(
            self._view.values, detection.probabilities, detectable(rates, detection.snr_db)
        )

    def move(self, motion: Motion, *, is_known: bool) -> None:
        """Let the sensor move."""
        self._view.go_round(self.place.move(motion, is_known=is_known))

    def worth(
        self, detection: Detection, measured: Measured, field: FieldOfView, starts: bool
    ) -> float:
        """Log-likelihood ratio of a detection being of this thing against being another's.

        -inf beyond the gate. What ``starts`` no track may be any echo there is.
        """
        if not self.place.is_near(measured):
            return -math.inf
        squared, log_density = self.place.surprise(measured)
        if squared > GATE:
            return -math.inf
        reported = self._detectable()
        others = self._rates.false_alarms_per_ping if starts else self._rates.clutter_per_ping
        density = (others + _NEW_PER_PING) / field.volume
        paid = math.log(reported) - math.log(1.0 - reported)
        return log_density - math.log(density) + paid + self._same_size(detection)

    def hear(
        self, detection: Detection, measured: Measured, time_ns: int, field: FieldOfView
    ) -> None:
        """Take a detection in."""
        _, log_density = self.place.surprise(measured)
        by_chance = math.log(self._rates.false_alarms_per_ping / field.volume)
        reported = self._detectable()
        self.place.update(measured)
        range_m, azimuth, _ = self.place.seen
        self._view.look(range_m, azimuth)
        self.evidence.heard(
            self._view.values, detection.probabilities, reported, log_density - by_chance
        )
        self._latest, self._latest_place = detection, self.place.seen
        self.heard_ns, self.silence = time_ns, 0.0

    def miss(self, field: FieldOfView) -> None:
        """Take in that it was not heard, if it should have been."""
        seen = self.place.seen
        if not field.holds(seen):
            return
        reported = self._detectable()
        self._view.look(seen[0], seen[1])
        self.evidence.missed(self._view.values, reported)
        self.silence += math.log(1.0 - reported)

    def fused(self) -> Detection:
        """What all its pings together tell; level and tilt are the latest ping's."""
        range_m, azimuth, elevation = (float(value) for value in self.place.seen)
        covariance = self.place.seen_covariance()
        return Detection(
            self.label,
            self.evidence.probabilities(),
            range_m,
            azimuth,
            elevation,
            tuple((a, b, c) for a, b, c in covariance.tolist()),
            self._latest.snr_db,
            self._latest.tilt_rad,
        )

    def _detectable(self) -> float:
        known, at, value = self._reported
        if known is not self._latest or at is not self.place.seen:  # asked for by each detection
            level_db = self._latest.snr_db
            if self._latest_place is not self.place.seen:
                level_db += level_change_db(self._latest_place, self.place.seen)
            value = detectable(self._rates, level_db)
            # What clutter would be reported as often as would prove nothing.
            value = max(value, self._rates.chance)
            self._reported = self._latest, self.place.seen, value
        return value

    def _same_size(self, detection: Detection) -> float:
        """How much likelier its sizes are if it is this thing than if it is any."""
        own, told = self.evidence.size_share(), detection.probabilities
        heard = [told.get(label, 0.0) for label in own]
        both = sum(one * share for one, share in zip(heard, own.values(), strict=True))
        return math.log(max(both * len(own) / max(sum(heard), 1e-9), _LEAST_LIKENESS))
