"""How well events agree with what a simulated scene really held."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ertis_driver.errors import ErtisError

MAX_RANGE_ERROR_M = 0.15
MAX_BEARING_ERROR_RAD = math.radians(6.0)

Place = Mapping[str, Any]  # has range_m, azimuth_rad, elevation_rad


class TruthError(ErtisError):
    """A truth or event log cannot be read: it is another file, or damaged."""


@dataclass(frozen=True, slots=True)
class Score:
    """How many landmarks were found, and how well.

    pings : int
        Pings whose truth is known.
    present : int
        Landmarks that could be heard, summed over those pings.
    located : int
        Of those, reported within 0.15 m and 6 degrees.
    right_class : int
        Of the located, reported with the right size.
    false : int
        Reports with no landmark there, visible or hidden.
    range_rms_m, bearing_rms_rad : float
        Errors of the located; NaN if there are none.
    announced, announced_right : int
        New tracks, and those of them on a landmark, visible or hidden, of that size.
    """

    pings: int
    present: int
    located: int
    right_class: int
    false: int
    range_rms_m: float
    bearing_rms_rad: float
    announced: int = 0
    announced_right: int = 0


def read_jsonl(path: Path) -> list[dict[str, Any]]:
    """Objects of a JSON Lines file; a last line cut short by a killed writer is left out.

    Raises
    ------
    TruthError
        If the file cannot be read or another line is no JSON object.
    """
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise TruthError(f"{path}: {error}") from error
    objects = []
    for number, line in enumerate(lines[:-1], 1):  # what follows the last newline is cut or empty
        if not line.strip():
            continue
        try:
            value = json.loads(line)
        except ValueError as error:
            raise TruthError(f"{path}:{number}: not JSON: {error}") from error
        if not isinstance(value, dict):
            raise TruthError(f"{path}:{number}: expected a JSON object")
        objects.append(value)
    return objects


def bearing_error_rad(a: Place, b: Place) -> float:
    """Angle between two bearings, rad; exact for small ones (haversine)."""
    up = math.sin((a["elevation_rad"] - b["elevation_rad"]) / 2) ** 2
    across = math.sin((a["azimuth_rad"] - b["azimuth_rad"]) / 2) ** 2
    across *= math.cos(a["elevation_rad"]) * math.cos(b["elevation_rad"])
    return 2 * math.asin(min(1.0, math.sqrt(up + across)))


def compare(events: Iterable[Mapping[str, Any]], truth: Iterable[Mapping[str, Any]]) -> Score:
    """Compare events with truth, ping by ping.

    Parameters
    ----------
    events
        As published, parsed from JSON. Landmarks in state ``lost`` claim nothing about the ping.
    truth
        ``{"ping_index": .., "landmarks": [{"label", "range_m", "azimuth_rad", "elevation_rad",
        "visible"}]}``; pings that it does not name are left out.

    Raises
    ------
    TruthError
        If a line lacks a field, or one of its numbers is none of this world.
    """
    try:
        return _compare(events, truth)
    except (KeyError, TypeError, ValueError) as error:
        raise TruthError(f"an event or truth line lacks or garbles a field: {error}") from error


def _compare(events: Iterable[Mapping[str, Any]], truth: Iterable[Mapping[str, Any]]) -> Score:
    heard: dict[int, list[Place]] = {}
    for event in events:
        reports = [r for r in event["landmarks"] if r["state"] != "lost" and _known_place(r)]
        heard.setdefault(event["ping_index"], []).extend(reports)
    pings = present = right = false = announced = announced_right = 0
    range_errors_m: list[float] = []
    bearing_errors_rad: list[float] = []
    for line in truth:
        pings += 1
        visible = [place for place in line["landmarks"] if place["visible"]]
        hidden = [place for place in line["landmarks"] if not place["visible"]]
        present += len(visible)
        pairs, left = _match(visible, heard.get(line["ping_index"], []))
        false += len(_match(hidden, left)[1])
        new = [r for r in heard.get(line["ping_index"], []) if r["state"] == "new"]
        announced += len(new)
        on_landmarks = _match(line["landmarks"], new)[0]
        announced_right += sum(r["class"] == place["label"] for place, r in on_landmarks)
        for place, report in pairs:
            right += report["class"] == place["label"]
            range_errors_m.append(report["range_m"] - place["range_m"])
            bearing_errors_rad.append(bearing_error_rad(report, place))
    return Score(
        pings=pings,
        present=present,
        located=len(range_errors_m),
        right_class=right,
        false=false,
        range_rms_m=_rms(range_errors_m),
        bearing_rms_rad=_rms(bearing_errors_rad),
        announced=announced,
        announced_right=announced_right,
    )


def _known_place(report: Place) -> bool:
    return all(report[key] is not None for key in ("range_m", "azimuth_rad", "elevation_rad"))


def _match(
    places: list[Place], reports: list[Place]
) -> tuple[list[tuple[Place, Place]], list[Place]]:
    """Pairs of place and report, nearest first, each used once; and the reports left over."""
    near = []
    for p, place in enumerate(places):
        for r, report in enumerate(reports):
            along_m = abs(report["range_m"] - place["range_m"])
            angle_rad = bearing_error_rad(report, place)
            if along_m <= MAX_RANGE_ERROR_M and angle_rad <= MAX_BEARING_ERROR_RAD:
                worst = max(along_m / MAX_RANGE_ERROR_M, angle_rad / MAX_BEARING_ERROR_RAD)
                near.append((worst, p, r))
    pairs: dict[int, int] = {}
    for _, p, r in sorted(near):
        if p not in pairs and r not in pairs.values():
            pairs[p] = r
    left = [report for r, report in enumerate(reports) if r not in pairs.values()]
    return [(places[p], reports[r]) for p, r in pairs.items()], left


def _rms(values: list[float]) -> float:
    return math.sqrt(sum(v * v for v in values) / len(values)) if values else math.nan


def summary(score: Score) -> str:
    """Put the score in one line, for people."""
    if not score.present:
        return f"no landmark was present in {score.pings} simulated pings; {score.false} false"
    text = (
        f"{score.announced} announced, {score.announced_right} of them rightly; followed with the "
        f"right size in {score.right_class} of the {score.present} times that a landmark was "
        f"present in a ping of the simulated scene, {score.located} located, {score.false} false"
    )
    if not score.located:
        return text
    return text + (
        f"; rms errors {1000 * score.range_rms_m:.1f} mm in range, "
        f"{math.degrees(score.bearing_rms_rad):.1f} degrees in bearing (all simulated)"
    )
