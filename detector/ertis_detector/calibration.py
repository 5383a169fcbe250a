"""Do probabilities come true: reliability diagram and expected calibration error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import NONE
from ertis_detector.intervals import COVERAGE, NO_INTERVAL, RESAMPLES, Interval, wilson
from ertis_detector.recalibration import fit_recalibration

NUM_BINS = 10
_SURE = 1e-6  # told probabilities are kept from 0 and 1 by so much
_NO_OR_YES = (NONE, "landmark")

Float = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Predictions of nearly one probability: what they said on average, and what came true."""

    low: float
    high: float
    told: float
    came_true: float
    count: int
    interval: Interval


@dataclass(frozen=True, slots=True)
class Reliability:
    """Bins that hold a prediction, and their mean distance from the diagonal.

    expected_error : float
        Expected calibration error (Naeini, Cooper and Hauskrecht 2015), ten bins of equal width;
        NaN without predictions.
    interval : (low, high)
        95 %, groups drawn again. It lies high with few predictions: chance alone is an error.
    """

    bins: tuple[ReliabilityBin, ...]
    expected_error: float
    interval: Interval


def recalibrated(
    told: Float, came_true: npt.NDArray[np.bool_], environments: Sequence[str]
) -> Float:
    """Probabilities as they would be told after a look at all other environments; shape (n,).

    Log odds get a slope and an offset (Platt 1999) that are fitted to what came true elsewhere.

    Parameters
    ----------
    told : shape (n,), in [0, 1]
    came_true : bool, shape (n,)
    environments : n names, of two or more
    """
    sure = np.clip(told, _SURE, 1 - _SURE)
    logarithms = np.log(np.stack([1 - sure, sure], axis=1))
    names, truth = np.asarray(environments), came_true.astype(np.intp)
    better = np.zeros(told.size)
    for name in np.unique(names):
        here = names == name
        law = fit_recalibration(logarithms[~here], truth[~here], _NO_OR_YES)
        better[here] = law.applied(logarithms[here], _NO_OR_YES)[:, 1]
    return better


def reliability(
    told: Float,
    came_true: npt.NDArray[np.bool_],
    groups: Sequence[str],
    *,
    seed: int = 0,
) -> Reliability:
    """Compare probabilities with what came true.

    Parameters
    ----------
    told : shape (n,), in [0, 1]
    came_true : bool, shape (n,)
    groups : n names
        Predictions of one group are not independent.
    """
    if told.size == 0:
        return Reliability((), float("nan"), NO_INTERVAL)
    place = np.minimum((told * NUM_BINS).astype(np.intp), NUM_BINS - 1)
    bins = []
    for number in np.unique(place):
        inside = place == number
        count, yes = int(inside.sum()), int(came_true[inside].sum())
        bins.append(
            ReliabilityBin(
                number / NUM_BINS,
                (number + 1) / NUM_BINS,
                float(told[inside].mean()),
                yes / count,
                count,
                wilson(yes, count),
            )
        )
    names, index = np.unique(np.asarray(groups), return_inverse=True)
    # What each group adds to each bin's sum of (told - came true); the error follows from sums.
    surplus = np.zeros((names.size, NUM_BINS))
    np.add.at(surplus, (index, place), told - came_true)
    sizes = np.bincount(index, minlength=names.size)
    error = float(np.abs(surplus.sum(axis=0)).sum() / told.size)
    if names.size < 2:
        return Reliability(tuple(bins), error, NO_INTERVAL)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(names.size, np.full(names.size, 1 / names.size), RESAMPLES)
    errors = np.abs(drawn @ surplus).sum(axis=1) / (drawn @ sizes)
    tail = 100 * (1 - COVERAGE) / 2
    low, high = np.percentile(errors, (tail, 100 - tail))
    return Reliability(tuple(bins), error, (float(low), float(high)))
