"""Recordings with truth to a model: decode, scan, label, fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_daemon.pipeline import build_scanner
from ertis_detector.air import Air
from ertis_detector.classifier import Fit, fit
from ertis_detector.detection import NONE, UNKNOWN
from ertis_detector.labelling import label_candidates
from ertis_detector.model import Model, ModelCard, file_sha256
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.chirp import Emission
from ertis_driver.device import Settings
from ertis_driver.errors import RecordingError
from ertis_driver.recording import RecordedPing, Recording, open_recording

LEAST_PRECISION = 0.75  # three reports in four: more would silence it, fewer would mislead a robot

_LEAST_REPORTS = 20  # fewer say nothing of a precision


@dataclass(slots=True)
class TrainingRows:
    """What all candidates of all recordings teach."""

    features: list[npt.NDArray[np.float32]] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)
    groups: list[str] = field(default_factory=list)


def train(
    paths: Sequence[Path], name: str, progress: Callable[[int], None] = lambda pings: None
) -> Model:
    """Make a model of recordings that were all made with one chirp.

    Parameters
    ----------
    paths : MCAP recordings with truth
    name : str
        What events will call the model.
    progress
        Called with the number of pings read.

    Raises
    ------
    RecordingError
        If a recording has no truth, no chirp or another chirp, or too little is in them.
    """
    recordings = [open_recording(path) for path in paths]
    chirp = _one_chirp(recordings)
    rows = TrainingRows()
    decoder = PdmDecoder()
    pings = 0
    for recording in recordings:
        for ping in recording:
            _learn(rows, ping, recording, chirp, decoder)
            pings += 1
            progress(pings)
    try:
        fitted = fit(np.stack(rows.features), rows.labels, rows.groups)
    except ValueError as error:
        raise RecordingError(f"too little to train on in {pings} pings: {error}") from error
    reports = _Reports(fitted, rows.labels)
    least = _least_probability(reports)
    sources = sorted({recording.info.source for recording in recordings})
    digests = ", ".join(
        f"{recording.info.address} sha256 {file_sha256(path)[:16]}"
        for recording, path in zip(recordings, paths, strict=True)
    )
    card = ModelCard(
        name=name or "-".join([*sources, chirp.name]),
        chirp=chirp.name,
        audio_filter=FILTER_VERSION,
        source="+".join(sources),
        data=f"{pings} pings: {digests}",
        min_probability=least,
        figures=_figures(reports, pings, least),
    )
    return Model(fitted.classifier, card)


def _one_chirp(recordings: Sequence[Recording]) -> Emission:
    first = recordings[0].info.chirp
    for recording in recordings:
        chirp = recording.info.chirp
        if chirp is None:
            raise RecordingError(f"{recording.path}: says no chirp, expected one to train for")
        if first is not None and chirp.name != first.name:
            raise RecordingError(
                f"{recording.path}: chirp {chirp.name}, expected {first.name} as in "
                f"{recordings[0].path}: train one model a chirp"
            )
    assert first is not None  # checked above
    return first


def _learn(
    rows: TrainingRows,
    ping: RecordedPing,
    recording: Recording,
    chirp: Emission,
    decoder: PdmDecoder,
) -> None:
    if ping.truth is None:
        raise RecordingError(
            f"{recording.path}: ping {ping.frame.ping_index} has no truth: nothing to learn from"
        )
    temperature_c = 20.0 if ping.temperature_c is None else ping.temperature_c
    scanner = build_scanner(
        Settings(chirp, recording.info.num_words), Air(temperature_c).speed_of_sound_m_s
    )
    audio = decoder.decode(whole_samples(ping.frame.words)).audio
    baseband, candidates = scanner.candidates(audio)
    if not candidates:
        return
    seen = scanner.features(baseband, candidates)
    for features, label in zip(seen, label_candidates(candidates, ping.truth), strict=True):
        if label is not None:
            rows.features.append(features)
            rows.labels.append(label)
            rows.groups.append(str(ping.truth.get("scene", ping.frame.ping_index)))


def _least_probability(reports: _Reports) -> float:
    """Lowest threshold from 0.5 on from which enough reports on unseen scenes are landmarks.

    0.99 if there is none: such a model all but keeps silent.
    """
    thresholds = np.round(np.arange(0.5, 1.0, 0.01), 2)
    for threshold in thresholds:
        reported = reports.landmark_probability >= threshold
        right = reported & reports.is_landmark
        if right.sum() >= max(LEAST_PRECISION * reported.sum(), _LEAST_REPORTS):
            return float(threshold)
    return float(thresholds[-1])


class _Reports:
    """What cross-validation says of each proposal, whether or not it would be reported."""

    def __init__(self, fitted: Fit, labels: Sequence[str]) -> None:
        classes = np.asarray(fitted.classifier.classes)
        landmark = ~np.isin(classes, (NONE, UNKNOWN))
        chosen = fitted.probabilities[:, landmark]
        self.landmark_probability = chosen.sum(axis=1)
        truth = np.asarray(labels)
        self.is_landmark = ~np.isin(truth, (NONE, UNKNOWN))
        self.size_right = classes[landmark][chosen.argmax(axis=1)] == truth


def _figures(reports: _Reports, pings: int, threshold: float) -> dict[str, float]:
    """Of proposals, not of dishes: cross-validated on scenes left out."""
    reported = reports.landmark_probability >= threshold
    landmarks = max(int(reports.is_landmark.sum()), 1)
    found = reported & reports.is_landmark
    return {
        "proposals": float(len(reported)),
        "landmark_proposals": float(landmarks),
        "precision": round(float(found.sum() / max(int(reported.sum()), 1)), 4),
        "found": round(float(found.sum() / landmarks), 4),
        "found_with_right_size": round(float((reported & reports.size_right).sum() / landmarks), 4),
        "size_right_if_found": round(
            float(reports.size_right[found].mean()) if found.any() else 0.0, 4
        ),
        "false_alarms_per_ping": round(float((reported & ~reports.is_landmark).sum() / pings), 4),
    }
