"""Recorded drives without a landmark: how firmly a model and a tracker believed in one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ertis_daemon.pipeline import detector_of, rounded
from ertis_daemon.workers import Workers
from ertis_detector.air import Air
from ertis_detector.detection import Detection
from ertis_detector.detector import LandmarkDetector
from ertis_detector.drives import peaks
from ertis_detector.false_tracks import FalseTracks
from ertis_detector.model import FOLLOWING_PROBABILITY, Model
from ertis_detector.motion import Motion, PlanarPose
from ertis_detector.rates import DetectorRates
from ertis_detector.tracker import Tracker
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.device import Settings
from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording

_PARTS = 8  # a recording is read in so many turns
_PAUSE_NS = 5_000_000_000  # longer, and another drive begins


class _Ping(NamedTuple):
    """What was detected, and where the sonar was, if anybody knows."""

    number: int
    time_ns: int
    detections: list[Detection]
    scene: str
    pose: PlanarPose | None


def false_tracks(
    paths: Sequence[Path],
    model: Model,
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
) -> tuple[FalseTracks, int]:
    """How often what drives met was believed to be a landmark, and pings heard.

    A drive ends where another scene begins, where nothing was heard for 5 s, and where time goes
    back. Where the sonar was is believed if the recording's truth says so.

    Parameters
    ----------
    paths : MCAP recordings of drives without a landmark in hearing
    model : Model
    workers : int
        Processes; what comes out does not depend on it.
    progress
        Called with the number of pings read.

    Raises
    ------
    RecordingError
        If one cannot be read, has another chirp than the model's, or a landmark in it.
    DetectorError
        If too little was taken for a landmark at all to say anything.
    """
    found: list[float] = []
    rates = DetectorRates.from_figures(model.card.tracking)
    pings = 0
    for path in paths:
        heard: list[_Ping] = []
        jobs = [(path, part) for part in range(_PARTS)]
        for some in Workers(workers)(_Listen(model), jobs):
            heard += some
            progress(pings + len(heard))
        pings += len(heard)
        for drive in _drives(sorted(heard)):
            found += peaks(_moved(drive), Tracker(rates))
    return FalseTracks.of(found, pings), pings


@dataclass(frozen=True)
class _Listen:
    """Detections of every ``_PARTS``-th ping of a recording; runs in a worker process."""

    model: Model

    def __call__(self, job: tuple[Path, int]) -> list[_Ping]:
        path, part = job
        recording = open_recording(path)
        chirp = recording.info.chirp
        if chirp is None:
            raise RecordingError(f"{path}: says no chirp, expected {self.model.card.chirp}")
        info = recording.info
        settings = Settings(chirp, info.num_words, pdm_rate_hz=info.pdm_rate_hz)
        decoder, heard = PdmDecoder(), []
        for number, ping in enumerate(recording):
            if number % _PARTS != part:
                continue
            truth = ping.truth or {}
            if truth.get("landmarks"):
                raise RecordingError(
                    f"{path}: ping {ping.frame.ping_index} has a landmark in it, expected drives "
                    "without any: record one, or give it as labelled data"
                )
            air = rounded(Air.measured(ping.temperature_c, ping.humidity_percent))
            detector = _detector(self.model, settings, air)
            audio = decoder.decode(whole_samples(ping.frame.words)).audio
            heard.append(
                _Ping(
                    number,
                    ping.frame.ping_time_ns,
                    detector.detect(audio),
                    str(truth.get("scene", "")),
                    _pose(truth.get("pose")),
                )
            )
        return heard


@lru_cache(maxsize=4)
def _detector(model: Model, settings: Settings, air: Air) -> LandmarkDetector:
    return detector_of(model, settings, air, FOLLOWING_PROBABILITY)


def _pose(told: Any) -> PlanarPose | None:
    try:
        values = [float(told[name]) for name in ("x_m", "y_m", "yaw_rad")]
    except (KeyError, TypeError, ValueError):
        return None
    return PlanarPose(*values) if all(map(math.isfinite, values)) else None


def _drives(pings: Sequence[_Ping]) -> Iterator[list[_Ping]]:
    drive: list[_Ping] = []
    for ping in pings:
        if drive:
            elapsed_ns = ping.time_ns - drive[-1].time_ns
            if ping.scene != drive[-1].scene or not 0 <= elapsed_ns <= _PAUSE_NS:
                yield drive
                drive = []
        drive.append(ping)
    if drive:
        yield drive


def _moved(drive: Sequence[_Ping]) -> Iterator[tuple[list[Detection], int, Motion | None]]:
    before: PlanarPose | None = None
    for ping in drive:
        now = ping.pose
        yield ping.detections, ping.time_ns, Motion.between(before, now) if before and now else None
        before = now
