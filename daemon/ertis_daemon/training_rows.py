"""Recordings with truth to what a model learns from: every candidate's features and label."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ertis_daemon.labelled import recorded_truth, recordings_in
from ertis_daemon.pipeline import build_scanner, rounded
from ertis_daemon.workers import Workers
from ertis_detector.air import Air
from ertis_detector.detection import NONE, is_landmark, radius_m
from ertis_detector.features import NUM_FEATURES
from ertis_detector.labelling import match_candidates
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.chirp import Emission
from ertis_driver.dataset import METADATA, DatasetRow
from ertis_driver.device import Settings
from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording

if TYPE_CHECKING:
    from ertis_detector.scanner import Scanner

_PARTS = 8  # a recording is read in so many turns
# Where a person's label points, rather than where a simulator put it.
_LABEL_ELEVATION_RAD = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrainingRows:
    """What all candidates of all pings are.

    features : float32, shape (n, num_features)
    labels, groups : n strings
        What a report of it would have to say: a dish by another way than straight is ``none``.
        Rows of one group (one scene, or one session of a data set) hear the same clutter.
    teaches : bool, shape (n,)
        Not what is heard by another way, nor dishes turned too far away or hidden.
    in_sight : bool, shape (n,)
        A landmark could be heard in its ping.
    place, truth : shape (n, 3) and (n, 4)
        Range, azimuth, elevation of the peak; of the landmark's vertex, and its tilt; NaN for
        what is none.
    snr_db : shape (n,)
    pings, pings_in_sight : int
        All, and those in which a landmark could be heard.
    """

    features: npt.NDArray[np.float32]
    labels: list[str]
    groups: list[str]
    place: npt.NDArray[np.float64]
    truth: npt.NDArray[np.float64]
    snr_db: npt.NDArray[np.float64]
    teaches: npt.NDArray[np.bool_]
    in_sight: npt.NDArray[np.bool_]
    pings: int
    pings_in_sight: int


@dataclass(frozen=True, slots=True)
class _Job:
    """Every ``_PARTS``-th ping of a recording; or one of a data set, with its line of the table."""

    path: Path
    part: int
    row: DatasetRow | None
    chirp_name: str


class _Row(NamedTuple):
    features: npt.NDArray[np.float32]
    label: str
    group: str
    place: tuple[float, ...]
    truth: tuple[float, ...]
    snr_db: float
    teaches: bool
    in_sight: bool


def read_rows(
    paths: Sequence[Path],
    chirp: Emission,
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
) -> TrainingRows:
    """Features and labels of all pings.

    Parameters
    ----------
    paths : recordings with truth, and folders of labelled data sets
    chirp : Emission
        That all must have been made with.
    workers : int
        Processes.
    progress
        Called with the number of pings read.

    Raises
    ------
    RecordingError, DatasetError
        If one has no truth or another chirp, or cannot be read.
    SettingsError
        If one is named twice: its pings would count twice.
    """
    rows: list[_Row] = []
    pings = pings_in_sight = 0
    for heard, in_sight, learnt in Workers(workers)(_learn, list(_jobs(paths, chirp))):
        pings += heard
        pings_in_sight += in_sight
        rows.extend(learnt)
        progress(pings)
    return TrainingRows(
        np.array([row.features for row in rows], np.float32).reshape(-1, NUM_FEATURES),
        [row.label for row in rows],
        [row.group for row in rows],
        np.array([row.place for row in rows]).reshape(-1, 3),
        np.array([row.truth for row in rows]).reshape(-1, 4),
        np.array([row.snr_db for row in rows]),
        np.array([row.teaches for row in rows], bool),
        np.array([row.in_sight for row in rows], bool),
        pings,
        pings_in_sight,
    )


def _jobs(paths: Sequence[Path], chirp: Emission) -> Iterator[_Job]:
    for path, row in recordings_in(paths):
        met = open_recording(path).info.chirp
        if met is None or met.name != chirp.name:
            raise RecordingError(
                f"{path}: chirp {met.name if met else 'not said'}, expected {chirp.name} "
                "as in the first: train one model a chirp"
            )
        for part in range(_PARTS if row is None else 1):
            yield _Job(path, part, row, chirp.name)


def _learn(job: _Job) -> tuple[int, int, list[_Row]]:
    """Pings, those with a landmark in sight, and rows of one job; runs in a worker process."""
    recording = open_recording(job.path)
    assert recording.info.chirp is not None  # looked at before
    info = recording.info
    settings = Settings(recording.info.chirp, info.num_words, pdm_rate_hz=info.pdm_rate_hz)
    decoder, rows = PdmDecoder(), []
    heard = heard_in_sight = 0
    for number, ping in enumerate(recording):
        if job.row is None and number % _PARTS != job.part:
            continue
        heard += 1
        truth = recorded_truth(job.row, ping.truth)
        if truth is None and job.row is not None:
            truth = labelled_truth(job.row)
        if truth is None:
            raise RecordingError(
                f"{job.path}: ping {ping.frame.ping_index} has no truth: nothing to learn from; a "
                "labelled recording's is in the table of its data set, so name that folder"
            )
        scanner = _scanner(
            settings, rounded(Air.measured(ping.temperature_c, ping.humidity_percent))
        )
        audio = decoder.decode(whole_samples(ping.frame.words)).audio
        heard_in_sight += _in_sight(truth)
        rows.extend(_candidates(scanner, audio, truth, f"{job.path.name} {number}"))
    return heard, heard_in_sight, rows


@lru_cache(maxsize=16)
def _scanner(settings: Settings, air: Air) -> Scanner:
    return build_scanner(settings, air)


def _candidates(
    scanner: Scanner, audio: npt.NDArray[np.float32], truth: dict[str, Any], number: str
) -> list[_Row]:
    baseband, scape = scanner.image(audio)
    candidates = scanner.candidates(baseband, scape)
    if not candidates:
        return []
    features = scanner.features(baseband, candidates)
    group, in_sight = str(truth.get("scene", number)), _in_sight(truth)
    rows: list[_Row] = []
    for seen, one, (label, item) in zip(
        features, candidates, match_candidates(candidates, truth), strict=True
    ):
        at = one.location
        rows.append(
            _Row(
                seen,
                label or (NONE if item is None else str(item["label"])),
                group,
                (at.range_m, at.azimuth_rad, at.elevation_rad),
                _where(label, item),
                one.snr_db,
                label is not None,
                in_sight,
            )
        )
    return rows


def _in_sight(truth: dict[str, Any]) -> bool:
    """Whether a landmark can be heard; a person labels only what can."""
    return any(item.get("visible", True) for item in truth["landmarks"])


def _where(label: str | None, item: Any) -> tuple[float, float, float, float]:
    if item is None or label is None or not is_landmark(label):
        return (math.nan,) * 4
    tilt = item.get("tilt_rad", math.nan)
    return (item["range_m"], item["azimuth_rad"], item["elevation_rad"], tilt)


def labelled_truth(row: DatasetRow) -> dict[str, Any]:
    """Truth of a ping of a data set as its labeller put it.

    A person's label has a range, a bearing and a turn; a dish hangs as high as the sonar.

    Raises
    ------
    RecordingError
        If a landmark's row lacks its range or bearing.
    """
    group = f"{row.environment}/{row.session}"
    if row.label == NONE:
        return {"scene": group, "landmarks": [], "decoys": []}
    if math.isnan(row.range_m) or math.isnan(row.azimuth_rad):
        raise RecordingError(
            f"{METADATA}: {row.file_name} is labelled {row.label} without range_m or azimuth_deg: "
            "fill them in"
        )
    item = {
        "label": row.label,
        "radius_m": radius_m(row.label) or 0.0,
        "range_m": row.range_m,
        "azimuth_rad": row.azimuth_rad,
        "elevation_rad": _LABEL_ELEVATION_RAD,
    }
    if not math.isnan(row.yaw_rad):
        item["tilt_rad"] = abs(row.yaw_rad)
    return {"scene": group, "landmarks": [item], "decoys": []}
