"""A model's probabilities, made to come true where somebody has recorded and labelled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_daemon.drives import false_tracks
from ertis_daemon.report.detector_data import FLOOR
from ertis_daemon.training import check_scenes, first_chirp, name_of
from ertis_daemon.training_reports import GREATEST_THRESHOLD, Reports, weights_of
from ertis_daemon.training_rows import TrainingRows, read_rows
from ertis_detector.calibration import reliability
from ertis_detector.detection import is_landmark, landmark_mask
from ertis_detector.fitting import folds
from ertis_detector.model import (
    TRACKING_PROBABILITY,
    Model,
    ModelCard,
    load_model,
    shipped_model,
)
from ertis_detector.recalibration import Recalibration, fit_recalibration
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.errors import RecordingError

_LEAST_PINGS, _LEAST_EACH = 200, 20
_LEAST_PROBABILITY = 1e-9
_DRIVES = "; drives without landmarks, "  # last in a card's ``data``
_RULE_OF_THREE = 3.0  # events that none having been seen may still hide (Poisson, 95 %)

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Calibrated:
    """A model, the law it got, and what that is worth.

    as_told, elsewhere : float
        Expected calibration error before; and with the law that all other scenes or sessions
        suggest, so of what it has not met.
    """

    model: Model
    law: Recalibration
    as_told: float
    elsewhere: float


def calibrate(
    paths: Sequence[Path],
    model_path: Path | None,
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
) -> Calibrated:
    """Fit slope and offsets of a model's log odds to labelled recordings.

    The threshold moves along, so that what is reported of a single ping hardly changes. What
    changes is how sure it is said to be, which is what a tracker adds up, and the figures that it
    is told.

    Parameters
    ----------
    paths : MCAP recordings with truth, and folders of labelled data sets
    model_path : Path or None
        None: the one shipped for the recordings' chirp.
    workers : int
        Processes; the model does not depend on it.
    progress
        Called with the number of pings read.

    Raises
    ------
    RecordingError, DatasetError
        If one has no truth, no chirp or another chirp, a size that the model does not know, or too
        little is in them.
    ModelError, ModelMismatch
        If the model cannot be read, or is for another chirp.
    """
    chirp, source = first_chirp(paths)
    model = load_model(model_path or shipped_model(chirp.name))
    model.check(chirp=chirp.name, audio_filter=FILTER_VERSION)
    rows = read_rows(paths, chirp, workers, progress)
    _check(rows, model)
    weights, in_sight = weights_of(rows)
    logarithms = _logarithms(model, rows)
    truth = np.array([model.classes.index(label) for label in rows.labels])
    law = fit_recalibration(logarithms, truth, model.classes, weights)
    if law.slope <= 0:
        raise RecordingError(
            f"the surer the model is here, the less it is right (slope {law.slope:.2f}): look at "
            "the labels' range_m and azimuth_deg, or train a model of your own"
        )
    before, elsewhere = _errors(rows, model, logarithms, truth, weights)
    probabilities = law.applied(logarithms, model.classes).astype(np.float32)
    reports = Reports(model.classes, probabilities, rows, weights)
    card = _card(model.card, law, reports, source, name_of(rows.pings, paths), in_sight)
    made = replace(model, classifier=law.of(model.classifier), card=card)
    return Calibrated(made, law, before, elsewhere)


def calibrate_tracker(
    model: Model,
    paths: Sequence[Path],
    workers: int,
    progress: Callable[[int], None] = lambda pings: None,
) -> Model:
    """The same model, its card telling how often a tracker falls for what is no landmark.

    Parameters
    ----------
    paths : MCAP recordings of drives without a landmark in hearing

    Raises
    ------
    RecordingError, DetectorError
        See ``false_tracks``.
    """
    _, source = first_chirp(paths)
    law, pings = false_tracks(paths, model, workers, progress)
    old = model.card
    card = replace(
        old,
        source=_sources(old.source, source),
        data=f"{_undriven(old)}{_DRIVES}{name_of(pings, paths)}",
        tracking={**old.tracking, **law.figures()},
    )
    return replace(model, card=card)


def _check(rows: TrainingRows, model: Model) -> None:
    strange = sorted(set(rows.labels) - set(model.classes))
    if strange:
        raise RecordingError(
            f"labels {', '.join(strange)}: the model knows {', '.join(model.classes)}; train one "
            "of your own with 'ertis train'"
        )
    landmarks = sum(is_landmark(label) for label in rows.labels)
    others = len(rows.labels) - landmarks
    if rows.pings < _LEAST_PINGS or min(landmarks, others) < _LEAST_EACH:
        raise RecordingError(
            f"{rows.pings} pings with {landmarks} echoes of landmarks and {others} of other "
            f"things, expected {_LEAST_PINGS} pings and {_LEAST_EACH} of each or more: record more"
        )
    check_scenes(rows)


def _logarithms(model: Model, rows: TrainingRows) -> Float:
    told = model.classifier.probabilities(rows.features)
    return np.asarray(np.log(np.maximum(told.astype(np.float64), _LEAST_PROBABILITY)))


def _errors(
    rows: TrainingRows,
    model: Model,
    logarithms: Float,
    truth: npt.NDArray[np.intp],
    weights: Float,
) -> tuple[float, float]:
    """Expected calibration error as told, and by laws of other scenes or sessions."""
    landmark = landmark_mask(model.classes)
    better = np.zeros_like(logarithms)
    for known, unseen in folds(rows.groups):
        law = fit_recalibration(logarithms[known], truth[known], model.classes, weights[known])
        better[unseen] = law.applied(logarithms[unseen], model.classes)

    def error(probabilities: Float) -> float:
        sizes = np.where(landmark, probabilities, 0.0)
        said, best = sizes.max(axis=1), sizes.argmax(axis=1)
        told = said >= FLOOR
        groups = [group for group, yes in zip(rows.groups, told, strict=True) if yes]
        return reliability(said[told], (best == truth)[told], groups).expected_error

    return error(np.exp(logarithms)), error(better)


def _card(
    old: ModelCard, law: Recalibration, reports: Reports, source: str, data: str, in_sight: float
) -> ModelCard:
    least = min(round(law.threshold(old.min_probability), 3), GREATEST_THRESHOLD)
    tracking = reports.figures(TRACKING_PROBABILITY)
    alarms = max(tracking["false_alarms_per_ping"], round(_RULE_OF_THREE / reports.pings, 5))
    return replace(
        old,
        name=f"{old.name}-calibrated",
        source=_sources(old.source, source),
        data=f"{_undriven(old)}; recalibrated on {data}",
        min_probability=least,
        in_sight=in_sight,
        figures=reports.figures(least),
        tracking={**tracking, "false_alarms_per_ping": alarms},
    )


def _undriven(card: ModelCard) -> str:
    """What a model was made of, but for drives: another law makes them meaningless."""
    return card.data.partition(_DRIVES)[0]


def _sources(one: str, other: str) -> str:
    return "+".join(sorted({*one.split("+"), *other.split("+")}))
