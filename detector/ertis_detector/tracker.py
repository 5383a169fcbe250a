"""Detections over pings to tracks: few events, and right ones."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Literal

import numpy as np

from ertis_detector.association import assign
from ertis_detector.detection import Detection
from ertis_detector.false_tracks import FalseTracks
from ertis_detector.followed import Followed
from ertis_detector.model import TRACKING_PROBABILITY
from ertis_detector.motion import Motion
from ertis_detector.place import Measured
from ertis_detector.rates import S_PER_HOUR, DetectorRates
from ertis_detector.visibility import FieldOfView

log = logging.getLogger(__name__)

MAX_FOLLOWED = 24  # announced or not; a detector proposes eight a ping
MAX_TAKEN = 16  # detections of one ping, the most probable first
_FOR_SIZES = 0.2  # of the false events allowed; a size is soon sure
_SILENT = math.log(0.05)  # so improbable a silence ends a track
_GIVEN_UP = math.log(1e-3)  # so improbable a landmark is not followed further
_WITHDRAWN = math.log(0.1)  # an announced one so improbable is lost

State = Literal["new", "update", "lost"]


@dataclass(frozen=True, slots=True)
class Track:
    """One landmark followed over pings; ``detection`` is what all of its pings tell."""

    track_id: int
    state: State
    detection: Detection


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """What is asked of a tracker, and how the sensor may move.

    max_false_events_per_hour : float
        Four fifths of it for what is no landmark, the rest for landmarks of another size.
    landmarks_per_hour : float
        Landmarks met; of so many the wrong sizes are counted.
    ping_rate_hz : float
        Pings a second; rather too many than too few.
    max_speed_m_s, max_turn_rad_s : float
        Of the sensor, where odometry is missing.
    max_silence_s : float
        A landmark in view and not heard is kept for so long at least.
    max_unheard_s : float
        A landmark out of view is kept for so long at most.
    start_probability : float
        Of a landmark, from which on a detection that is of nothing followed is followed.
    """

    max_false_events_per_hour: float = 1.0
    landmarks_per_hour: float = 60.0
    ping_rate_hz: float = 7.0
    max_speed_m_s: float = 1.0
    max_turn_rad_s: float = math.radians(60.0)
    max_silence_s: float = 1.5
    max_unheard_s: float = 10.0
    start_probability: float = TRACKING_PROBABILITY

    def least_existence(self, rates: DetectorRates) -> float:
        """Log-likelihood ratio from which a landmark is announced.

        Which drives without a landmark have shown to be passed so seldom. If nobody drove: each
        false alarm starts a track at most, and a likelihood ratio of what is no landmark ever
        exceeds A with probability 1 / A at most (Ville 1939), however long it is followed; so of
        N false alarms N / A are announced at most.
        """
        per_ping = self.false_tracks_per_hour / (self.ping_rate_hz * S_PER_HOUR)
        law = rates.false_tracks or FalseTracks(rates.false_alarms_per_ping, 1.0)
        return max(law.level(per_ping), 0.0)

    @property
    def false_tracks_per_hour(self) -> float:
        """Of what is no landmark, that may be announced."""
        return (1.0 - _FOR_SIZES) * self.max_false_events_per_hour

    @property
    def least_size_probability(self) -> float:
        """Probability from which a size is announced; a wrong one is a false event, too."""
        wrong = _FOR_SIZES * self.max_false_events_per_hour / self.landmarks_per_hour
        return 1.0 - min(wrong, 0.5)


class Tracker:
    """Follows landmarks from ping to ping, and announces those that the evidence suffices for.

    Parameters
    ----------
    rates : DetectorRates
        Of the detector whose detections come; cautious ones if left out.
    settings : TrackerSettings
    field : FieldOfView
        Where the detector reports landmarks.
    """

    def __init__(
        self,
        rates: DetectorRates | None = None,
        settings: TrackerSettings | None = None,
        field: FieldOfView | None = None,
    ) -> None:
        self._rates = rates or DetectorRates()
        self._settings = settings or TrackerSettings()
        self._field = field or FieldOfView()
        self._least_existence = self._settings.least_existence(self._rates)
        self._followed: list[Followed] = []
        self._next_id = 1
        self._time_ns: int | None = None

    @property
    def followed(self) -> tuple[Followed, ...]:
        """Landmarks and what may turn out to be none, announced or not."""
        return tuple(self._followed)

    def update(
        self,
        detections: Sequence[Detection],
        ping_time_ns: int,
        motion: Motion | None = None,
    ) -> list[Track]:
        """Tracks that this ping starts, continues or ends.

        Parameters
        ----------
        detections : of one ping, most probable first
            Less probable ones than ``start_probability`` are taken for what is followed already.
        ping_time_ns : int
            If it goes backwards (a recording played again, a clock set), all tracks end.
        motion : Motion or None
            Of the sensor since the ping before; None if nobody knows.

        Returns
        -------
        list of Track
            Announced in this ping, heard again in it, or lost. Nothing twice but a landmark whose
            size turns out to be another: that track is lost, and a new one announced once that is
            sure.
        """
        usable = [one for one in detections if _is_finite(one)][:MAX_TAKEN]
        if len(usable) < len(detections):
            log.warning("%d detections left out", len(detections) - len(usable))
        tracks = self._pass_time(ping_time_ns, motion)
        heard = self._hear(usable, ping_time_ns)
        ended = [one for one in self._followed if self._is_over(one, ping_time_ns)]
        self._followed = [one for one in self._followed if one not in ended]
        ended += self._crowd_out()
        for one in heard:
            if one in self._followed:
                tracks += self._judge(one)
        return [*tracks, *(lost for one in ended for lost in _lose(one))]

    def _pass_time(self, now_ns: int, motion: Motion | None) -> list[Track]:
        """Move everything; end what cannot be the same any more."""
        before_ns, self._time_ns = self._time_ns, now_ns
        if before_ns is None:
            return []
        if now_ns < before_ns:
            log.warning("time went back by %.3f s: all tracks end", (before_ns - now_ns) / 1e9)
            ended, self._followed = self._followed, []
            return [lost for one in ended for lost in _lose(one)]
        tracks = self._forget(now_ns)
        elapsed_s = (now_ns - before_ns) / 1e9
        own = self._settings
        moved = motion or Motion.unknown(elapsed_s, own.max_speed_m_s, own.max_turn_rad_s)
        for one in self._followed:
            one.move(moved, is_known=motion is not None)
        return tracks

    def _forget(self, now_ns: int) -> list[Track]:
        oldest_ns = now_ns - round(self._settings.max_unheard_s * 1e9)
        ended = [one for one in self._followed if one.heard_ns < oldest_ns]
        self._followed = [one for one in self._followed if one.heard_ns >= oldest_ns]
        return [lost for one in ended for lost in _lose(one)]

    def _hear(self, detections: Sequence[Detection], now_ns: int) -> list[Followed]:
        """Give each detection to the thing it is of; what is none's starts one."""
        followed = list(self._followed)
        measured = [(one, Measured(one)) for one in detections]
        least = self._settings.start_probability
        starts = [one.landmark_probability >= least for one in detections]
        worth = np.array(
            [
                [one.worth(*d, self._field, new) for d, new in zip(measured, starts, strict=True)]
                for one in followed
            ]
        )
        pairs = assign(worth.reshape(len(followed), len(detections)))
        heard, taken = [], set()
        for row, column in pairs:
            followed[row].hear(*measured[column], now_ns, self._field)
            heard.append(followed[row])
            taken.add(column)
        for row in set(range(len(followed))) - {row for row, _ in pairs}:
            followed[row].miss(self._field)
        for column, detection in enumerate(detections):
            if column not in taken and starts[column]:
                heard.append(Followed(detection, now_ns, self._rates))
                self._followed.append(heard[-1])
        return heard

    def _judge(self, one: Followed) -> list[Track]:
        """What there is to say of a thing that was heard."""
        tracks: list[Track] = []
        shares = one.evidence.size_share()
        if not shares:
            return []
        label = max(shares, key=lambda name: shares[name])
        if one.track_id is not None and label != one.label:
            tracks += _lose(one)
        state: State = "update"
        if one.track_id is None:
            if (
                one.evidence.existence < self._least_existence
                or shares[label] < self._settings.least_size_probability
            ):
                return tracks
            state, one.label, one.track_id = "new", label, self._next_id
            self._next_id += 1
        one.reported = one.fused()
        return [*tracks, Track(one.track_id, state, one.reported)]

    def _is_over(self, one: Followed, now_ns: int) -> bool:
        """Whether it is silent where it should be heard, or no landmark after all."""
        silence_ns = now_ns - one.heard_ns
        patience_ns = round(self._settings.max_silence_s * 1e9)
        if one.silence < _SILENT and silence_ns > patience_ns:
            return True
        if one.track_id is None:
            return one.evidence.existence < _GIVEN_UP
        # Silence alone has its own patience, above.
        return silence_ns == 0 and one.evidence.existence < _WITHDRAWN

    def _crowd_out(self) -> list[Followed]:
        """Keep the number of things bounded: the least probable ones go."""
        ranked = sorted(
            self._followed, key=lambda one: (one.track_id is None, -one.evidence.existence)
        )
        self._followed = ranked[:MAX_FOLLOWED]
        return ranked[MAX_FOLLOWED:]


def _lose(one: Followed) -> list[Track]:
    """The end of a track; of one never announced, nothing is said."""
    number, one.track_id = one.track_id, None
    if number is None or one.reported is None:
        return []
    return [Track(number, "lost", one.reported)]


def _is_finite(detection: Detection) -> bool:
    place = detection.range_m, detection.azimuth_rad, detection.elevation_rad
    numbers = (*place, detection.snr_db, *chain.from_iterable(detection.covariance))
    return all(map(math.isfinite, numbers)) and detection.range_m > 0
