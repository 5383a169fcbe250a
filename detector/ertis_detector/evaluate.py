"""How good detections are where the range is not told: found, right, false, in time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from ertis_detector.accuracy import PlaceErrors, place_errors
from ertis_detector.calibration import Reliability, recalibrated, reliability
from ertis_detector.detection import Detection, is_landmark
from ertis_detector.errors import EvaluationError
from ertis_detector.intervals import Interval, cluster_bootstrap, garwood, wilson
from ertis_detector.matching import JudgedPing, Matches, TrueLandmark, match

Float = npt.NDArray[np.float64]

DEFAULT_RATE_HZ = 7.0  # pings a second of the robot that false alarms are told for
_THRESHOLDS = np.unique(np.concatenate([np.arange(0.05, 1.0, 0.025), [0.98, 0.99, 0.995, 0.999]]))


@dataclass(frozen=True, slots=True)
class Rate:
    """A share, how often it was asked, and how sure it is.

    independent : Wilson's interval, as if every ping were alone
    clustered : groups drawn again; (nan, nan) with fewer than two groups
    """

    successes: int
    trials: int
    independent: Interval
    clustered: Interval

    @property
    def share(self) -> float:
        """NaN if it was never asked."""
        return self.successes / self.trials if self.trials else float("nan")


@dataclass(frozen=True, slots=True)
class Found:
    """Of landmarks that meet a condition: located, and located with the right size."""

    located: Rate
    right_size: Rate


@dataclass(frozen=True, slots=True)
class Point:
    """What one reporting threshold gives; shares, NaN where nothing was asked."""

    threshold: float
    located: float
    right_size: float
    precision: float
    false_per_free_ping: float


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """Reports of nothing at the threshold.

    free_pings : pings without any landmark
    on_free : reports in them
    per_minute : on landmark-free pings, at ``rate_hz`` pings a second
    interval : of it, 95 % (Garwood)
    elsewhere : reports of nothing in pings that hold a landmark
    """

    free_pings: int
    on_free: int
    rate_hz: float
    per_minute: float
    interval: Interval
    elsewhere: int


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Everything about one detector on one set of pings.

    conditions : name of a condition -> landmarks that meet it
    over : variable -> (low, high, found) of each of its bins
    sizes, size_confusion : located landmarks' labels, and counts with truth down
    reliability : of probabilities as they are told
    recalibrated : of the same after a look at all other environments; None if fewer than two
    seconds : of each ping, NaN left out
    """

    num_pings: int
    num_groups: int
    threshold: float
    conditions: Mapping[str, Found]
    over: Mapping[str, list[tuple[float, float, Found]]]
    curve: tuple[Point, ...]
    false_alarms: FalseAlarms
    sizes: tuple[str, ...]
    size_confusion: Float
    reliability: Reliability
    recalibrated: Reliability | None
    place: PlaceErrors
    seconds: Float


Condition = Callable[[TrueLandmark], bool]

# The target, the ring-down's reach, and everything that can be heard at all.
CONDITIONS: Mapping[str, Condition] = {
    "can be heard": lambda one: one.visible,
    "tilt < 25, |azimuth| < 20 degrees, signal-to-clutter >= 0 dB": lambda one: (
        one.visible
        and one.tilt_rad < np.deg2rad(25.0)
        and abs(one.azimuth_rad) < np.deg2rad(20.0)
        and one.own_to_rest_db >= 0.0
    ),
    "nearer than 1 m (ring-down)": lambda one: one.visible and one.range_m < 1.0,
    "beyond what is asked (turned, hidden, aside)": lambda one: not one.visible,
}

_EDGES: Mapping[str, tuple[Callable[[TrueLandmark], float], Sequence[float]]] = {
    "range (m)": (lambda one: one.range_m, (0.6, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.2)),
    "|azimuth| (degrees)": (
        lambda one: abs(float(np.rad2deg(one.azimuth_rad))),
        (0, 5, 10, 15, 20, 25, 30, 45, 60),
    ),
    "tilt (degrees)": (
        lambda one: float(np.rad2deg(one.tilt_rad)),
        (0, 5, 10, 15, 20, 25, 30, 35, 45, 60),
    ),
    "signal-to-clutter (dB)": (
        lambda one: one.own_to_rest_db,
        (-30, -15, -10, -5, 0, 5, 10, 15, 20, 30),
    ),
}


def landmark_probability(told: Detection) -> float:
    """That it is a landmark of any size: what the reporting threshold is held against."""
    return sum(p for name, p in told.probabilities.items() if is_landmark(name))


def evaluate(
    pings: Sequence[JudgedPing],
    threshold: float,
    *,
    rate_hz: float = DEFAULT_RATE_HZ,
) -> Evaluation:
    """Judge a detector by what it said of pings whose truth is known.

    Parameters
    ----------
    pings
        With detections well under the threshold too, or the curve is cut short.
    threshold : float
        Reported is what is a landmark with this probability at least.
    rate_hz : float
        Pings a second that false alarms are told for.

    Raises
    ------
    EvaluationError
        Without pings.
    """
    if not pings:
        raise EvaluationError("no pings to judge: name recordings with truth, or a data set")
    reported = [_reported(ping, threshold) for ping in pings]
    matches = [match(ping.landmarks, told) for ping, told in zip(pings, reported, strict=True)]
    asked = _asked(pings, reported, matches)
    sizes, confusion = _confusion(asked)
    as_told, elsewhere = _reliability(pings)
    seconds = np.array([ping.seconds for ping in pings])
    return Evaluation(
        num_pings=len(pings),
        num_groups=len({ping.group for ping in pings}),
        threshold=threshold,
        conditions={
            name: _found([one for one in asked if condition(one.landmark)])
            for name, condition in CONDITIONS.items()
        },
        over={
            name: _over([one for one in asked if one.landmark.visible], value, edges, name)
            for name, (value, edges) in _EDGES.items()
        },
        curve=tuple(_point(pings, float(t)) for t in np.unique(np.append(_THRESHOLDS, threshold))),
        false_alarms=_false_alarms(pings, matches, rate_hz),
        sizes=sizes,
        size_confusion=confusion,
        reliability=as_told,
        recalibrated=elsewhere,
        place=place_errors(
            [
                (one.landmark, one.report)
                for one in asked
                if one.report is not None and one.landmark.visible
            ]
        ),
        seconds=seconds[~np.isnan(seconds)],
    )


@dataclass(frozen=True, slots=True)
class _Asked:
    """A landmark, its report if it has one, and its ping's group."""

    landmark: TrueLandmark
    report: Detection | None
    group: str


def _reported(ping: JudgedPing, threshold: float) -> list[Detection]:
    return [told for told in ping.detections if landmark_probability(told) >= threshold]


def _asked(
    pings: Sequence[JudgedPing],
    reported: Sequence[Sequence[Detection]],
    matches: Sequence[Matches],
) -> list[_Asked]:
    asked = []
    for ping, told, pairs in zip(pings, reported, matches, strict=True):
        both = pairs.found | pairs.beyond
        for number, landmark in enumerate(ping.landmarks):
            report = told[both[number]] if number in both else None
            asked.append(_Asked(landmark, report, ping.group))
    return asked


def _found(asked: Sequence[_Asked]) -> Found:
    groups = [one.group for one in asked]
    located = [one.report is not None for one in asked]
    right = [one.report is not None and one.report.label == one.landmark.label for one in asked]
    return Found(rate(located, groups), rate(right, groups))


def rate(yes: Sequence[bool], groups: Sequence[str]) -> Rate:
    """Share of what is true, with both intervals."""
    successes, trials = sum(yes), len(yes)
    return Rate(
        successes,
        trials,
        wilson(successes, trials),
        cluster_bootstrap(np.array(yes, float), groups),
    )


def _over(
    asked: Sequence[_Asked],
    value: Callable[[TrueLandmark], float],
    edges: Sequence[float],
    name: str,
) -> list[tuple[float, float, Found]]:
    values = np.array([value(one.landmark) for one in asked])
    rows = []
    for low, high in pairwise(edges):
        inside = [one for one, v in zip(asked, values, strict=True) if low <= v < high]
        if inside:
            rows.append((float(low), float(high), _found(inside)))
    return rows


def _point(pings: Sequence[JudgedPing], threshold: float) -> Point:
    present = located = right = false = free = false_free = 0
    for ping in pings:
        told = _reported(ping, threshold)
        pairs = match(ping.landmarks, told)
        present += sum(one.visible for one in ping.landmarks)
        located += len(pairs.found)
        right += sum(told[r].label == ping.landmarks[n].label for n, r in pairs.found.items())
        false += len(pairs.false)
        if not ping.landmarks:
            free += 1
            false_free += len(pairs.false)
    return Point(
        threshold,
        _share(located, present),
        _share(right, present),
        _share(located, located + false),
        _share(false_free, free),
    )


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")


def _false_alarms(
    pings: Sequence[JudgedPing], matches: Sequence[Matches], rate_hz: float
) -> FalseAlarms:
    free = [not ping.landmarks for ping in pings]
    counts = [len(one.false) for one in matches]
    on_free = sum(count for count, is_free in zip(counts, free, strict=True) if is_free)
    minutes = sum(free) / rate_hz / 60
    return FalseAlarms(
        free_pings=sum(free),
        on_free=on_free,
        rate_hz=rate_hz,
        per_minute=on_free / minutes if minutes else float("nan"),
        interval=garwood(on_free, minutes),
        elsewhere=sum(counts) - on_free,
    )


def _confusion(asked: Sequence[_Asked]) -> tuple[tuple[str, ...], Float]:
    pairs = [
        (one.landmark.label, one.report.label)
        for one in asked
        if one.report is not None and one.landmark.visible
    ]
    names = tuple(sorted({name for pair in pairs for name in pair}))
    counts = np.zeros((len(names), len(names)))
    for true, told in pairs:
        counts[names.index(true), names.index(told)] += 1
    return names, counts


def _reliability(pings: Sequence[JudgedPing]) -> tuple[Reliability, Reliability | None]:
    """Of every detection, under the threshold too: its label's probability, and was it right.

    As told, and after a look at all other environments.
    """
    told, right, groups, environments = [], [], [], []
    for ping in pings:
        pairs = match(ping.landmarks, ping.detections)
        true = {report: number for number, report in (pairs.found | pairs.beyond).items()}
        for number, one in enumerate(ping.detections):
            told.append(one.probabilities[one.label])
            right.append(number in true and ping.landmarks[true[number]].label == one.label)
            groups.append(ping.group)
            environments.append(ping.environment)
    said, came_true = np.array(told), np.array(right, bool)
    as_told = reliability(said, came_true, groups)
    if len(set(environments)) < 2 or "" in environments:
        return as_told, None
    return as_told, reliability(recalibrated(said, came_true, environments), came_true, groups)
