"""Recordings with truth to a model: fit, choose the threshold, write the card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_daemon.training_rows import TrainingRows, read_rows, recordings_of
from ertis_detector.detection import NONE, UNKNOWN
from ertis_detector.fitting import Fit, fit
from ertis_detector.model import TRACKING_PROBABILITY, Model, ModelCard, file_sha256
from ertis_detector.readout import Readout, fit_readout
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.chirp import Emission
from ertis_driver.dataset import open_dataset
from ertis_driver.errors import RecordingError

# A wrong landmark is worse than none: of clutter, one false detection a minute at 7 pings a second;
# of bowls and lampshades in view, one in fifty.
MAX_FALSE_PER_PING, MAX_DECOYS_REPORTED = 1 / 420, 0.02
_LEAST_LANDMARKS = 20  # fewer say nothing of an error's law


def train(
    paths: Sequence[Path],
    name: str,
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
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

    Raises
    ------
    RecordingError, DatasetError
        If a recording has no truth, no chirp or another chirp, or too little is in them.
    """
    chirp, source = _first_chirp(paths)
    rows = read_rows(paths, chirp, workers, progress)
    try:
        fitted = fit(rows.features, rows.labels, rows.groups, workers=workers)
    except ValueError as error:
        raise RecordingError(f"too little to train on in {rows.pings} pings: {error}") from error
    reports = _Reports(fitted, rows)
    least = reports.threshold()
    card = ModelCard(
        name=name or f"{source}-{chirp.name}",
        chirp=chirp.name,
        audio_filter=FILTER_VERSION,
        source=source,
        data=f"{rows.pings} pings: " + ", ".join(_name(path) for path in paths),
        min_probability=least,
        figures=reports.figures(least),
        tracking=reports.figures(TRACKING_PROBABILITY),
    )
    return Model(fitted.classifier, _readout(rows, reports, least), card)


def _readout(rows: TrainingRows, reports: _Reports, least: float) -> Readout:
    """Fitted to what would be reported: errors of what is not told to anybody do not count."""
    known = np.isfinite(rows.truth).all(axis=1) & reports.size_right
    known &= reports.probability >= least
    if known.sum() < _LEAST_LANDMARKS:
        raise RecordingError(
            f"{known.sum()} landmarks of known turn recognised in {rows.pings} pings, expected "
            f"{_LEAST_LANDMARKS} or more: record more, and fill in yaw_deg"
        )
    labels = [label for label, yes in zip(rows.labels, known, strict=True) if yes]
    return fit_readout(
        rows.features[known], labels, rows.place[known], rows.truth[known], rows.snr_db[known]
    )


def _first_chirp(paths: Sequence[Path]) -> tuple[Emission, str]:
    """The chirp of the first recording, and who made all of them."""
    chirp, sources = None, set()
    for recording, _ in recordings_of(paths):
        sources.add(recording.info.source)
        if chirp is None:
            chirp = recording.info.chirp
            if chirp is None:
                raise RecordingError(f"{recording.path}: says no chirp, expected one to train for")
    if chirp is None:
        raise RecordingError(f"no recording in {', '.join(map(str, paths))}: nothing to learn from")
    return chirp, "+".join(sorted(sources))


def _name(path: Path) -> str:
    """How the card names what was learnt from."""
    if path.is_dir():
        return f"data set {open_dataset(path).manifest_hash[:16]}"
    return f"recording sha256 {file_sha256(path)[:16]}"


class _Reports:
    """What cross-validation says of each candidate, whether or not it would be reported."""

    def __init__(self, fitted: Fit, rows: TrainingRows) -> None:
        classes = np.asarray(fitted.classifier.classes)
        landmark = ~np.isin(classes, (NONE, UNKNOWN))
        chosen = fitted.probabilities[:, landmark]
        self.probability: npt.NDArray[np.float32] = chosen.sum(axis=1)
        truth = np.asarray(rows.labels)
        self.is_clutter, self.is_decoy = truth == NONE, truth == UNKNOWN
        self.is_landmark = ~(self.is_clutter | self.is_decoy)
        self.size_right = classes[landmark][chosen.argmax(axis=1)] == truth
        self.pings = rows.pings

    def threshold(self) -> float:
        """Least probability from 0.5 on at which false reports are rare enough."""
        by_clutter = _rarer_than(self.probability[self.is_clutter], MAX_FALSE_PER_PING * self.pings)
        decoys = self.probability[self.is_decoy]
        by_decoys = _rarer_than(decoys, MAX_DECOYS_REPORTED * decoys.size)
        return round(min(max(0.5, by_clutter, by_decoys), 0.999), 3)

    def figures(self, threshold: float) -> dict[str, float]:
        """Of located proposals, not of dishes: cross-validated on scenes left out."""
        reported = self.probability >= threshold
        landmarks = max(int(self.is_landmark.sum()), 1)
        found = reported & self.is_landmark
        false, misled = reported & self.is_clutter, reported & self.is_decoy
        right = found & self.size_right
        return {
            "proposals": float(len(reported)),
            "landmark_proposals": float(landmarks),
            "precision": _part(int(found.sum()), int(reported.sum())),
            "found": _part(int(found.sum()), landmarks),
            "found_with_right_size": _part(int(right.sum()), landmarks),
            "size_right_if_found": _part(int(right.sum()), int(found.sum())),
            "false_alarms_per_ping": round(float(false.sum() / self.pings), 5),
            "decoys_reported": _part(int(misled.sum()), int(self.is_decoy.sum())),
        }


def _rarer_than(probability: npt.NDArray[np.float32], allowed: float) -> float:
    """Least threshold, in thousandths, that at most so many reach; 0 if all may."""
    ranked = np.sort(probability)[::-1]
    if ranked.size <= int(allowed):
        return 0.0
    return float(np.floor(1000 * ranked[int(allowed)] + 1) / 1000)


def _part(some: int, of: int) -> float:
    return round(some / max(of, 1), 4)
