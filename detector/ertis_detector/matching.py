"""Which report is of which landmark: by gates in range and bearing, each used once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ertis_detector.detection import Detection

RANGE_GATE_M = 0.15  # three dish radii: farther off it is another echo
BEARING_GATE_RAD = math.radians(6.0)  # the array's beam


@dataclass(frozen=True, slots=True)
class TrueLandmark:
    """A landmark that stood there.

    label : str
    range_m, azimuth_rad, elevation_rad : float
        Of its vertex; elevation NaN if nobody knows.
    tilt_rad : float
        Between its axis and the line of sight; NaN if nobody knows.
    visible : bool
        It can be heard: not hidden, turned away, off the beam, or too near.
    own_to_rest_db : float
        Its echo's energy against everything else in its fragment, dB; NaN if nobody knows.
    """

    label: str
    range_m: float
    azimuth_rad: float
    elevation_rad: float = math.nan
    tilt_rad: float = math.nan
    visible: bool = True
    own_to_rest_db: float = math.nan

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> TrueLandmark:
        """As a recording's truth tells of one.

        Raises
        ------
        KeyError, TypeError, ValueError
            If a field is missing or garbled.
        """
        ratio_db = told.get("own_to_rest_db")
        return cls(
            label=str(told["label"]),
            range_m=float(told["range_m"]),
            azimuth_rad=float(told["azimuth_rad"]),
            elevation_rad=float(told["elevation_rad"]),
            tilt_rad=float(told.get("tilt_rad", math.nan)),
            visible=bool(told["visible"]),
            own_to_rest_db=math.nan if ratio_db is None else float(ratio_db),
        )


@dataclass(frozen=True, slots=True)
class JudgedPing:
    """What stood there and what was said of one ping.

    landmarks : all of them, heard or not
    detections : also those under the threshold that would be reported
    seconds : the detector's, NaN if nobody took the time
    group : pings of one group are not independent (one session, one scene)
    environment : what kind of place it was, empty if nobody knows
    """

    landmarks: tuple[TrueLandmark, ...]
    detections: tuple[Detection, ...]
    seconds: float
    group: str
    environment: str = ""


@dataclass(frozen=True, slots=True)
class Matches:
    """Pairs, and what is left over; indices into the ping's landmarks and the reports given.

    found : visible landmark -> its report
    beyond : hidden landmark -> its report: neither asked for nor wrong
    false : reports of nothing
    """

    found: dict[int, int]
    beyond: dict[int, int]
    false: tuple[int, ...]


def bearing_error_rad(true: TrueLandmark, told: Detection) -> float:
    """Angle between two bearings (haversine); in azimuth only, if no elevation is known."""
    if math.isnan(true.elevation_rad):
        return abs(true.azimuth_rad - told.azimuth_rad)
    up = math.sin((true.elevation_rad - told.elevation_rad) / 2) ** 2
    across = math.sin((true.azimuth_rad - told.azimuth_rad) / 2) ** 2
    across *= math.cos(true.elevation_rad) * math.cos(told.elevation_rad)
    return 2 * math.asin(min(1.0, math.sqrt(up + across)))


def match(landmarks: Sequence[TrueLandmark], reports: Sequence[Detection]) -> Matches:
    """Pair them, nearest first; visible landmarks choose before hidden ones."""
    taken: set[int] = set()
    pairs: list[dict[int, int]] = []
    for visible in (True, False):
        near = sorted(
            (gap, number, told)
            for number, true in enumerate(landmarks)
            if true.visible is visible
            for told, report in enumerate(reports)
            if told not in taken and (gap := _gap(true, report)) <= 1
        )
        found: dict[int, int] = {}
        for _, number, told in near:
            if number not in found and told not in taken:
                found[number] = told
                taken.add(told)
        pairs.append(found)
    left = tuple(told for told in range(len(reports)) if told not in taken)
    return Matches(pairs[0], pairs[1], left)


def _gap(true: TrueLandmark, told: Detection) -> float:
    """In gates; up to 1 is inside both. Not a number is outside."""
    gap = max(
        abs(true.range_m - told.range_m) / RANGE_GATE_M,
        bearing_error_rad(true, told) / BEARING_GATE_RAD,
    )
    return gap if np.isfinite(gap) else math.inf
