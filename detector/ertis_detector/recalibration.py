"""Three numbers that make a classifier's probabilities come true elsewhere than where it learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import expit, log_softmax, logit, softmax

from ertis_detector.classifier import Classifier
from ertis_detector.detection import UNKNOWN, landmark_mask

_ROUNDS = 60  # of Newton's; ten are enough where what is told is nearly true
_NOTHING = 1e-9  # a step as small changes no probability
_DOUBT = 0.1  # observations' worth of belief that what is told is true
LEAST_UNKNOWN = 20  # fewer bowls say nothing of how often bowls are met

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Recalibration:
    """Log odds get a slope (Platt 1999), and two kinds of classes an offset against ``none``.

    slope : float
        Over 1 where a classifier is too cautious.
    offset, unknown_offset : float
        Of landmarks, and of ``unknown``, nats: how much oftener each is met.
    """

    slope: float = 1.0
    offset: float = 0.0
    unknown_offset: float = 0.0

    def of(self, classifier: Classifier) -> Classifier:
        """The same votes, told by this law."""
        lift = self._lift(classifier.classes)
        return replace(
            classifier,
            coupling=np.asarray(self.slope * classifier.coupling, np.float32),
            offset=np.asarray(self.slope * classifier.offset + lift, np.float32),
        )

    def applied(self, logarithms: Float, classes: Sequence[str]) -> Float:
        """Probabilities by this law, of logarithms of probabilities; both (n, num_classes)."""
        return np.asarray(softmax(self.slope * logarithms + self._lift(classes), axis=1))

    def threshold(self, probability: float) -> float:
        """Where what was a landmark with this probability, or else nothing, is now."""
        return float(expit(self.slope * logit(probability) + self.offset))

    def _lift(self, classes: Sequence[str]) -> Float:
        return np.asarray(_kinds(classes) @ (self.offset, self.unknown_offset))


def fit_recalibration(
    logarithms: Float,
    truth: npt.NDArray[np.intp],
    classes: Sequence[str],
    weights: Float | None = None,
) -> Recalibration:
    """Most likely slope and offsets, drawn a little towards 1 and 0.

    That of ``unknown`` stays 0 where fewer than ``LEAST_UNKNOWN`` are.

    Parameters
    ----------
    logarithms : shape (n, num_classes)
        Of the probabilities as told.
    truth : shape (n,)
        Index of the class.
    classes : labels
    weights : shape (n,), or None
        How often each is met where probabilities must come true; None for equally often.
    """
    w = np.ones(len(truth)) if weights is None else weights
    rows = np.arange(len(truth))
    kinds = _kinds(classes)
    if np.sum(kinds[truth, 1]) < LEAST_UNKNOWN:
        kinds = kinds[:, :1]
    # What each number is multiplied by, shape (n, num_classes, how many).
    factors = np.empty((*logarithms.shape, 1 + kinds.shape[1]))
    factors[..., 0], factors[..., 1:] = logarithms, kinds
    as_told = np.eye(factors.shape[2])[0]

    def likelihood(law: Float) -> float:
        told = log_softmax(factors @ law, axis=1)[rows, truth]
        return float(w @ told - _DOUBT / 2 * np.sum((law - as_told) ** 2))

    law = as_told
    for _ in range(_ROUNDS):
        p = softmax(factors @ law, axis=1)
        mean = np.einsum("nc,nck->nk", p, factors)
        gradient = w @ (factors[rows, truth] - mean)
        second = np.einsum("n,nc,nck,ncl->kl", w, p, factors, factors, optimize=True)
        curvature = second - (w[:, None] * mean).T @ mean
        step = np.linalg.solve(
            curvature + _DOUBT * np.eye(law.size), gradient - _DOUBT * (law - as_told)
        )
        # Far from the top a whole step may pass it, to where all is sure and nothing bends.
        here = likelihood(law)
        while likelihood(law + step) < here and np.abs(step).max() > _NOTHING:
            step = step / 2
        law = law + step
        if np.abs(step).max() <= _NOTHING:
            break
    return Recalibration(*law.tolist())


def _kinds(classes: Sequence[str]) -> Float:
    """Which classes are landmarks, and which unknown; shape (num_classes, 2)."""
    unknown = [label == UNKNOWN for label in classes]
    return np.stack([landmark_mask(classes), unknown], axis=1).astype(np.float64)
