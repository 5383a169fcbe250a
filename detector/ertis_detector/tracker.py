"""Detections over pings to tracks: which of them are the same landmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ertis_detector.detection import Detection

GATE_M = 0.30  # a robot at 2 m/s and 7 pings a second
MAX_SILENCE_NS = 1_500_000_000

State = Literal["new", "update", "lost"]


@dataclass(frozen=True, slots=True)
class Track:
    """One landmark followed over pings; ``detection`` is the latest."""

    track_id: int
    state: State
    detection: Detection


@dataclass(slots=True)
class _Open:
    track_id: int
    detection: Detection
    heard_ns: int


class Tracker:
    """Names landmarks from ping to ping, by nearness and label. Adds no evidence of its own."""

    def __init__(self) -> None:
        self._open: list[_Open] = []
        self._next_id = 1

    def update(self, detections: Sequence[Detection], ping_time_ns: int) -> list[Track]:
        """Tracks that this ping starts, continues or ends.

        Parameters
        ----------
        detections : of one ping, most probable first
        ping_time_ns : int
            Must not go backwards by more than the silence allowed.
        """
        tracks = []
        free = list(self._open)
        for detection in detections:
            near = [one for one in free if _fits(one.detection, detection)]
            if near:
                one = min(near, key=lambda item: _gap_m(item.detection, detection))
                free.remove(one)
                one.detection, one.heard_ns = detection, ping_time_ns
                tracks.append(Track(one.track_id, "update", detection))
            else:
                self._open.append(_Open(self._next_id, detection, ping_time_ns))
                tracks.append(Track(self._next_id, "new", detection))
                self._next_id += 1
        for one in free:
            if ping_time_ns - one.heard_ns > MAX_SILENCE_NS:
                self._open.remove(one)
                tracks.append(Track(one.track_id, "lost", one.detection))
        return tracks


def _fits(a: Detection, b: Detection) -> bool:
    return a.label == b.label and _gap_m(a, b) < GATE_M


def _gap_m(a: Detection, b: Detection) -> float:
    """Distance in the horizontal plane: elevation is the array's weak side."""
    return float(
        np.hypot(
            a.range_m * np.cos(a.azimuth_rad) - b.range_m * np.cos(b.azimuth_rad),
            a.range_m * np.sin(a.azimuth_rad) - b.range_m * np.sin(b.azimuth_rad),
        )
    )
