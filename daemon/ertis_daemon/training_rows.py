"""Recordings with truth to what a model learns from: every candidate's features and label."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ertis_daemon.labelled import recorded_truth
from ertis_daemon.pipeline import build_scanner, rounded_temperature_c
from ertis_daemon.workers import Workers
from ertis_detector.detection import NONE, UNKNOWN, radius_m
from ertis_detector.features import NUM_FEATURES
from ertis_detector.labelling import match_candidates
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.chirp import Emission
from ertis_driver.dataset import METADATA, DatasetRow, open_dataset
from ertis_driver.device import Settings
from ertis_driver.errors import RecordingError
from ertis_driver.recording import Recording, open_recording

if TYPE_CHECKING:
    from ertis_detector.scanner import Scanner

_PARTS = 8  # a recording is read in so many turns
# Where a person's label points, rather than where a simulator put it.
_LABEL_ELEVATION_RAD = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrainingRows:
    """What all candidates of all pings teach.

    features : float32, shape (n, num_features)
    labels, groups : n strings
        Rows of one group (one scene, or one session of a data set) hear the same clutter.
    place, truth : shape (n, 3) and (n, 4)
        Range, azimuth, elevation of the peak; of the landmark's vertex, and its tilt; NaN for
        what is none.
    snr_db : shape (n,)
    pings : int
    """

    features: npt.NDArray[np.float32]
    labels: list[str]
    groups: list[str]
    place: npt.NDArray[np.float64]
    truth: npt.NDArray[np.float64]
    snr_db: npt.NDArray[np.float64]
    pings: int


@dataclass(frozen=True, slots=True)
class _Job:
    """Every ``_PARTS``-th ping of a recording; or one of a data set, with its line of the table."""

    path: Path
    part: int
    row: DatasetRow | None
    chirp_name: str


_Row = tuple[npt.NDArray[np.float32], str, str, tuple[float, ...], tuple[float, ...], float]


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
    """
    rows: list[_Row] = []
    pings = 0
    for heard, learnt in Workers(workers)(_learn, list(_jobs(paths, chirp))):
        pings += heard
        rows.extend(learnt)
        progress(pings)
    return TrainingRows(
        np.array([row[0] for row in rows], np.float32).reshape(-1, NUM_FEATURES),
        [row[1] for row in rows],
        [row[2] for row in rows],
        np.array([row[3] for row in rows]).reshape(-1, 3),
        np.array([row[4] for row in rows]).reshape(-1, 4),
        np.array([row[5] for row in rows]),
        pings,
    )


def recordings_of(paths: Iterable[Path]) -> Iterator[tuple[Recording, DatasetRow | None]]:
    """Open recordings, and those of labelled data sets with their lines of the table."""
    for path in paths:
        if path.is_dir():
            data = open_dataset(path)
            for row in data.rows:
                yield open_recording(data.path(row)), row
        else:
            yield open_recording(path), None


def _jobs(paths: Sequence[Path], chirp: Emission) -> Iterator[_Job]:
    for recording, row in recordings_of(paths):
        met = recording.info.chirp
        if met is None or met.name != chirp.name:
            raise RecordingError(
                f"{recording.path}: chirp {met.name if met else 'not said'}, expected {chirp.name} "
                "as in the first: train one model a chirp"
            )
        for part in range(_PARTS if row is None else 1):
            yield _Job(recording.path, part, row, chirp.name)


def _learn(job: _Job) -> tuple[int, list[_Row]]:
    """What one job's pings teach; runs in a worker process."""
    recording = open_recording(job.path)
    assert recording.info.chirp is not None  # looked at before
    settings = Settings(recording.info.chirp, recording.info.num_words)
    decoder, rows, heard = PdmDecoder(), [], 0
    for number, ping in enumerate(recording):
        if job.row is None and number % _PARTS != job.part:
            continue
        heard += 1
        truth = recorded_truth(job.row, ping.truth)
        if truth is None and job.row is not None:
            truth = labelled_truth(job.row)
        if truth is None:
            raise RecordingError(
                f"{job.path}: ping {ping.frame.ping_index} has no truth: nothing to learn from"
            )
        scanner = _scanner(settings, rounded_temperature_c(ping.temperature_c))
        audio = decoder.decode(whole_samples(ping.frame.words)).audio
        rows.extend(_candidates(scanner, audio, truth, f"{job.path.name} {number}"))
    return heard, rows


@lru_cache(maxsize=16)
def _scanner(settings: Settings, temperature_c: float) -> Scanner:
    return build_scanner(settings, temperature_c)


def _candidates(
    scanner: Scanner, audio: npt.NDArray[np.float32], truth: dict[str, Any], number: str
) -> list[_Row]:
    baseband, scape = scanner.image(audio)
    candidates = scanner.candidates(baseband, scape)
    if not candidates:
        return []
    features = scanner.features(baseband, candidates)
    group = str(truth.get("scene", number))
    rows: list[_Row] = []
    for seen, one, (label, item) in zip(
        features, candidates, match_candidates(candidates, truth), strict=True
    ):
        if label is not None:
            at = one.location
            place = (at.range_m, at.azimuth_rad, at.elevation_rad)
            rows.append((seen, label, group, place, _where(label, item), one.snr_db))
    return rows


def _where(label: str, item: Any) -> tuple[float, float, float, float]:
    if item is None or label in (NONE, UNKNOWN):
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
