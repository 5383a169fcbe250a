"""Recordings with truth to a model: fit, choose the threshold, write the card."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np

from ertis_daemon.labelled import recordings_in
from ertis_daemon.training_reports import Reports, weights_of
from ertis_daemon.training_rows import TrainingRows, read_rows
from ertis_detector.detection import NONE, is_landmark
from ertis_detector.fitting import LEAST_FOLDS, Echoes, fit
from ertis_detector.model import TRACKING_PROBABILITY, Model, ModelCard, file_sha256
from ertis_detector.readout import Readout, fit_readout
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.chirp import Emission
from ertis_driver.dataset import open_dataset
from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording

_LEAST_LANDMARKS = 20  # fewer say nothing of an error's law


def train(
    paths: Sequence[Path],
    name: str,
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
    *,
    calibrate: Sequence[Path] = (),
) -> Model:
    """Make a model of recordings that were all made with one chirp.

    Parameters
    ----------
    paths : MCAP recordings with truth, and folders of labelled data sets
    name : str
        What events will call the model.
    workers : int
        Processes; the model does not depend on it.
    progress
        Called with the number of pings read.
    calibrate : as ``paths``, or nothing
        Other scenes, for all that says how sure to be: the law of probabilities, the threshold,
        the errors' law and the figures. Without: cross-validation of the others.

    Raises
    ------
    RecordingError, DatasetError
        If a recording has no truth, no chirp or another chirp, too little is in them, or some
        scene is both learnt from and calibrated on.
    """
    chirp, source = first_chirp([*paths, *calibrate])
    taught = rows = read_rows(paths, chirp, workers, progress)
    if calibrate:
        rows = read_rows(calibrate, chirp, workers, lambda pings: progress(taught.pings + pings))
        _check_apart(taught, rows)
    _check_kinds(taught)
    check_scenes(rows)
    weights, in_sight = weights_of(rows)
    judged = Echoes(rows.features, rows.labels, rows.groups, weights)
    try:
        fitted = fit(
            Echoes(taught.features, taught.labels, taught.groups) if calibrate else judged,
            judged if calibrate else None,
            teaches=taught.teaches,
            workers=workers,
        )
    except ValueError as error:
        told = f"{taught.pings} pings" + (f", calibrated on {rows.pings}" if calibrate else "")
        raise RecordingError(f"too little to train on in {told}: {error}") from error
    reports = Reports(fitted.classifier.classes, fitted.probabilities, rows, weights)
    least = reports.threshold()
    card = ModelCard(
        name=name or f"{source}-{chirp.name}",
        chirp=chirp.name,
        audio_filter=FILTER_VERSION,
        source=source,
        data=name_of(taught.pings, paths)
        + (f"; calibrated on {name_of(rows.pings, calibrate)}" if calibrate else ""),
        min_probability=least,
        in_sight=in_sight,
        figures=reports.figures(least),
        tracking=reports.figures(TRACKING_PROBABILITY),
    )
    sizes = filter(is_landmark, fitted.classifier.classes)
    return Model(fitted.classifier, _readout(tuple(sizes), rows, reports, least), card)


def _check_apart(taught: TrainingRows, rows: TrainingRows) -> None:
    both = sorted(set(taught.groups) & set(rows.groups))
    if both:
        raise RecordingError(
            f"{len(both)} scenes or sessions are there to learn from and to be calibrated on, as "
            f"{both[0]!r}: expected others, or what was learnt by heart would be believed"
        )


def _check_kinds(rows: TrainingRows) -> None:
    met = set(rows.labels)
    if NONE not in met or not any(map(is_landmark, met)):
        raise RecordingError(
            f"echoes of {', '.join(sorted(met)) or 'nothing'} in {rows.pings} pings, expected some "
            f"of landmarks and some of what is none ({NONE!r}): record both"
        )


def check_scenes(rows: TrainingRows) -> None:
    """Raise RecordingError if too few are there to learn from some and judge by others."""
    count = len(set(rows.groups))
    if count < LEAST_FOLDS:
        raise RecordingError(
            f"{count} scenes or sessions in {rows.pings} pings, expected {LEAST_FOLDS} or more, to "
            "leave some out: record more of them"
        )


def _readout(sizes: Collection[str], rows: TrainingRows, reports: Reports, least: float) -> Readout:
    """Fitted to what would be reported: errors of what is not told to anybody do not count."""
    known = np.isfinite(rows.truth).all(axis=1) & reports.size_right
    known &= reports.probability >= least
    if known.sum() < _LEAST_LANDMARKS:
        raise RecordingError(
            f"{known.sum()} landmarks of known turn recognised in {rows.pings} pings, expected "
            f"{_LEAST_LANDMARKS} or more: record more, and fill in yaw_deg"
        )
    labels = [label for label, yes in zip(rows.labels, known, strict=True) if yes]
    missing = sorted(set(sizes) - set(labels))
    if missing:
        raise RecordingError(
            f"of {', '.join(missing)} none of known turn is recognised in {rows.pings} pings, "
            "expected some of each size: record more, and fill in yaw_deg"
        )
    return fit_readout(
        rows.features[known], labels, rows.place[known], rows.truth[known], rows.snr_db[known]
    )


def first_chirp(paths: Sequence[Path]) -> tuple[Emission, str]:
    """The chirp of the first recording, and who made all of them."""
    chirp, sources = None, set()
    for path, _ in recordings_in(paths):
        info = open_recording(path).info
        sources.add(info.source)
        if chirp is None:
            chirp = info.chirp
            if chirp is None:
                raise RecordingError(f"{path}: says no chirp, expected one to train for")
    if chirp is None:
        raise RecordingError(f"no recording in {', '.join(map(str, paths))}: nothing to learn from")
    return chirp, "+".join(sorted(sources))


def name_of(pings: int, paths: Sequence[Path]) -> str:
    """How the card names what was learnt from."""
    return f"{pings} pings: " + ", ".join(_file(path) for path in paths)


def _file(path: Path) -> str:
    if path.is_dir():
        return f"data set {open_dataset(path).manifest_hash[:16]}"
    return f"recording sha256 {file_sha256(path)[:16]}"
