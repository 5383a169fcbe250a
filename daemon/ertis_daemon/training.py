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
# Probabilities are to come true where a landmark is in sight in every other ping: decision 9.
IN_SIGHT = 0.5
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
    weights, in_sight = _weights(rows)
    try:
        fitted = fit(
            rows.features,
            rows.labels,
            rows.groups,
            teaches=rows.teaches,
            weights=weights,
            workers=workers,
        )
    except ValueError as error:
        raise RecordingError(f"too little to train on in {rows.pings} pings: {error}") from error
    reports = _Reports(fitted, rows, weights)
    least = reports.threshold()
    card = ModelCard(
        name=name or f"{source}-{chirp.name}",
        chirp=chirp.name,
        audio_filter=FILTER_VERSION,
        source=source,
        data=f"{rows.pings} pings: " + ", ".join(_name(path) for path in paths),
        min_probability=least,
        in_sight=in_sight,
        figures=reports.figures(least),
        tracking=reports.figures(TRACKING_PROBABILITY),
    )
    return Model(fitted.classifier, _readout(rows, reports, least), card)


def _weights(rows: TrainingRows) -> tuple[npt.NDArray[np.float64], float]:
    """How often each row's ping is met where probabilities must come true, and what part of pings.

    Where nearly all pings here have a landmark in sight, or nearly none has, they are left as they
    are: few would have to speak for many.
    """
    share = rows.pings_in_sight / max(rows.pings, 1)
    if not 0.1 <= share <= 0.9:
        return np.ones(len(rows.labels)), share
    met = np.where(rows.in_sight, IN_SIGHT / share, (1 - IN_SIGHT) / (1 - share))
    return met, IN_SIGHT


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

    def __init__(self, fitted: Fit, rows: TrainingRows, weights: npt.NDArray[np.float64]) -> None:
        classes = np.asarray(fitted.classifier.classes)
        landmark = ~np.isin(classes, (NONE, UNKNOWN))
        chosen = fitted.probabilities[:, landmark]
        self.probability: npt.NDArray[np.float32] = chosen.sum(axis=1)
        truth = np.asarray(rows.labels)
        self.is_none, self.is_decoy = truth == NONE, truth == UNKNOWN
        self.is_clutter = self.is_none & rows.teaches
        self.is_landmark = ~(self.is_none | self.is_decoy) & rows.teaches
        self.size_right = classes[landmark][chosen.argmax(axis=1)] == truth
        self.pings, self.weight = rows.pings, weights

    def threshold(self) -> float:
        """Least probability from 0.5 on at which false reports are rare enough."""
        by_clutter = self._rarer_than(self.is_clutter, MAX_FALSE_PER_PING * self.pings)
        decoys = self.weight[self.is_decoy].sum()
        by_decoys = self._rarer_than(self.is_decoy, MAX_DECOYS_REPORTED * decoys)
        return round(min(max(0.5, by_clutter, by_decoys), 0.999), 3)

    def figures(self, threshold: float) -> dict[str, float]:
        """Of located proposals, not of dishes: cross-validated on scenes left out.

        Of as many pings, weighted to have a landmark in sight as often as the card says.
        """
        reported = self.probability >= threshold
        found = reported & self.is_landmark
        right = found & self.size_right
        landmarks, located = self._sum(self.is_landmark), self._sum(found)
        misled = self._sum(reported & self.is_decoy)
        false = misled + self._sum(reported & self.is_none)
        return {
            "proposals": round(self._sum(self.is_landmark | self.is_none | self.is_decoy), 1),
            "landmark_proposals": round(landmarks, 1),
            "precision": _part(located, located + false),
            "found": _part(located, landmarks),
            "found_with_right_size": _part(self._sum(right), landmarks),
            "size_right_if_found": _part(self._sum(right), located),
            "false_alarms_per_ping": round(false / self.pings, 5),
            "decoys_reported": _part(misled, self._sum(self.is_decoy)),
        }

    def _sum(self, which: npt.NDArray[np.bool_]) -> float:
        return float(self.weight[which].sum())

    def _rarer_than(self, which: npt.NDArray[np.bool_], allowed: float) -> float:
        """Least threshold, in thousandths, that at most so many reach; 0 if all may."""
        order = np.argsort(self.probability[which])[::-1]
        ranked = self.probability[which][order]
        too_many = np.cumsum(self.weight[which][order]) > allowed
        if not too_many.any():
            return 0.0
        return float(np.floor(1000 * ranked[too_many.argmax()] + 1) / 1000)


def _part(some: float, of: float) -> float:
    return round(some / of, 4) if of else 0.0
