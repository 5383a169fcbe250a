"""Two numbers that make a classifier's probabilities come true elsewhere than where it learnt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import expit, log_softmax, logit, softmax

from ertis_detector.classifier import Classifier
from ertis_detector.detection import landmark_mask

_ROUNDS = 60  # of Newton's; ten are enough where what is told is nearly true
_NOTHING = 1e-9  # a step as small changes no probability
_DOUBT = 0.1  # observations' worth of belief that what is told is true

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Recalibration:
    """Log odds get a slope, and those of landmarks against all else an offset (Platt 1999).

    slope : float
        Over 1 where a classifier is too cautious.
    offset : float
        In nats.
    """

    slope: float = 1.0
    offset: float = 0.0

    def of(self, classifier: Classifier) -> Classifier:
        """The same votes, told by this law."""
        lift = self.offset * landmark_mask(classifier.classes)
        return replace(
            classifier,
            coupling=np.asarray(self.slope * classifier.coupling, np.float32),
            offset=np.asarray(self.slope * classifier.offset + lift, np.float32),
        )

    def threshold(self, probability: float) -> float:
        """Where what was a landmark with this probability is now."""
        return float(expit(self.slope * logit(probability) + self.offset))


def applied(law: Recalibration, logarithms: Float, landmark: npt.NDArray[np.bool_]) -> Float:
    """Probabilities by a law, of logarithms of probabilities; both of shape (n, num_classes)."""
    return np.asarray(softmax(law.slope * logarithms + law.offset * landmark, axis=1))


def fit_recalibration(
    logarithms: Float,
    truth: npt.NDArray[np.intp],
    landmark: npt.NDArray[np.bool_],
    weights: Float | None = None,
) -> Recalibration:
    """Most likely slope and offset, drawn a little towards 1 and 0.

    Parameters
    ----------
    logarithms : shape (n, num_classes)
        Of the probabilities as told.
    truth : shape (n,)
        Index of the class.
    landmark : bool, shape (num_classes,)
        Which classes get the offset.
    weights : shape (n,), or None
        How often each is met where probabilities must come true; None for equally often.
    """
    w = np.ones(len(truth)) if weights is None else weights
    rows = np.arange(len(truth))
    as_told = np.array([1.0, 0.0])

    def likelihood(law: Float) -> float:
        told = log_softmax(law[0] * logarithms + law[1] * landmark, axis=1)[rows, truth]
        return float(w @ told - _DOUBT / 2 * np.sum((law - as_told) ** 2))

    law = as_told
    for _ in range(_ROUNDS):
        p = applied(Recalibration(*law), logarithms, landmark)
        mean, landmarks = (p * logarithms).sum(axis=1), p @ landmark
        gradient = np.array(
            [w @ (logarithms[rows, truth] - mean), w @ (landmark[truth] - landmarks)]
        )
        both = w @ ((p * logarithms) @ landmark - mean * landmarks)
        curvature = np.array(
            [
                [w @ ((p * logarithms**2).sum(axis=1) - mean**2), both],
                [both, w @ (landmarks - landmarks**2)],
            ]
        )
        step = np.linalg.solve(curvature + _DOUBT * np.eye(2), gradient - _DOUBT * (law - as_told))
        # Far from the top a whole step may pass it, to where all is sure and nothing bends.
        here = likelihood(law)
        while likelihood(law + step) < here and np.abs(step).max() > _NOTHING:
            step /= 2
        law = law + step
        if np.abs(step).max() <= _NOTHING:
            break
    return Recalibration(*law.tolist())
