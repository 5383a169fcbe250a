"""Fits the classifier with scikit-learn, and says what it is worth on scenes left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.classifier import Classifier, both_votes, couple, evidence
from ertis_detector.fit_trees import fit_trees
from ertis_detector.networks import FEATURE_CAP, Committee

Float32 = npt.NDArray[np.float32]
Strings = npt.NDArray[np.str_]

NUM_NETWORKS = 4
NUM_FOLDS, _LEAST_FOLDS = 5, 3
HIDDEN = (128, 64)
_EPOCHS, _BATCH, _STEP, _WEIGHT_DECAY = 25, 256, 1e-3, 0.3
_LEAST_SCALE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A classifier and what cross-validation says of it.

    probabilities : float32, shape (n, num_classes)
        For each row, from networks that saw none of its group, and a law of probabilities fitted
        without it.
    """

    classifier: Classifier
    probabilities: Float32


def fit(
    features: Float32,
    labels: Sequence[str],
    groups: Sequence[str],
    *,
    teaches: npt.NDArray[np.bool_] | None = None,
    weights: npt.NDArray[np.float64] | None = None,
    num_networks: int = NUM_NETWORKS,
    num_folds: int = NUM_FOLDS,
    workers: int = 1,
) -> Fit:
    """Fit on all rows that teach; make probabilities by what each fold of unseen groups says.

    Parameters
    ----------
    features : float32, shape (n, num_features)
    labels, groups : n strings each
        Rows of one group (one scene) never stand on both sides of a fold.
    teaches : bool, shape (n,), or None
        Rows that networks and trees learn from; None for all. The law of probabilities is of all
        rows: it is asked of each echo, clear or not.
    weights : shape (n,), or None
        How often each row is met where probabilities must come true; None for as often as here.
    num_networks, num_folds : int
        Of folds no more than there are groups.
        Votes that the law is fitted to come of a part (1 - 1 / num_folds) of the rows, those that
        it is applied to of all: with few folds it is too cautious.
    workers : int
        Processes; the result does not depend on it.

    Raises
    ------
    ValueError
        With fewer than two classes, fewer than three groups, or a class that only one fold has.
    """
    from joblib import Parallel, delayed
    from sklearn.model_selection import GroupKFold

    label_array = np.asarray(labels)
    teaching = np.ones(len(label_array), bool) if teaches is None else teaches
    weight = np.ones(len(label_array)) if weights is None else weights
    classes = tuple(str(name) for name in np.unique(label_array[teaching]))
    if len(classes) < 2:
        raise ValueError(f"only {classes} among the labels: nothing to tell apart")
    num_folds = max(min(num_folds, len(set(groups))), _LEAST_FOLDS)
    folds = list(GroupKFold(num_folds).split(features, groups=groups))
    taught = [known[teaching[known]] for known, _ in folds] + [np.flatnonzero(teaching)]
    for known in taught:
        if len(np.unique(label_array[known])) < len(classes):
            raise ValueError(f"too few groups with each of {classes}: record more")
    networks = Parallel(n_jobs=workers)(
        delayed(_network)(features[known], label_array[known], seed)
        for known in taught
        for seed in range(num_networks)
    )
    forests = Parallel(n_jobs=workers)(
        delayed(fit_trees)(features[known], label_array[known]) for known in taught
    )
    committees = [
        _committee(features[known], networks[i * num_networks : (i + 1) * num_networks])
        for i, known in enumerate(taught)
    ]
    votes = np.zeros((len(features), 2 * len(classes)), np.float32)
    for (_, unseen), committee, trees in zip(folds, committees, forests, strict=False):
        votes[unseen] = both_votes(committee, trees, features[unseen])
    probabilities = np.zeros((len(features), len(classes)), np.float32)
    named = np.isin(label_array, classes)
    for known, unseen in folds:
        told = known[named[known]]
        law = _coupling(votes[told], label_array[told], weight[told])
        probabilities[unseen] = couple(votes[unseen], *law)
    law = _coupling(votes[named], label_array[named], weight[named])
    return Fit(Classifier(classes, committees[-1], forests[-1], *law), probabilities)


def _standard(features: Float32) -> tuple[Float32, Float32]:
    return features.mean(axis=0), np.maximum(features.std(axis=0), np.float32(_LEAST_SCALE))


def _network(features: Float32, labels: Strings, seed: int) -> list[Float32]:
    """Weights and biases of each layer of one network, output of every class."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPClassifier

    mean, scale = _standard(features)
    rows = np.clip((features - mean) / scale, -FEATURE_CAP, FEATURE_CAP)
    network = MLPClassifier(
        HIDDEN,
        alpha=_WEIGHT_DECAY,
        batch_size=min(_BATCH, len(rows)),
        learning_rate_init=_STEP,
        max_iter=_EPOCHS,
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # it is stopped early on purpose
        network.fit(rows, labels)
    weights, biases = list(network.coefs_), list(network.intercepts_)
    if len(network.classes_) == 2:  # scikit-learn keeps one output then: of the second class
        weights[-1] = np.concatenate([np.zeros_like(weights[-1]), weights[-1]], axis=1)
        biases[-1] = np.concatenate([np.zeros(1), biases[-1]])
    return [
        np.asarray(one, np.float32) for pair in zip(weights, biases, strict=True) for one in pair
    ]


def _committee(features: Float32, networks: Sequence[list[Float32]]) -> Committee:
    layers = [np.stack(same) for same in zip(*networks, strict=True)]
    biases = [bias[:, None, :] for bias in layers[1::2]]
    first, second, last = layers[::2]
    return Committee(*_standard(features), first, biases[0], second, biases[1], last, biases[2])


def _coupling(
    votes: Float32, labels: Strings, weights: npt.NDArray[np.float64]
) -> tuple[Float32, Float32]:
    from sklearn.linear_model import LogisticRegression

    regression = LogisticRegression(C=1.0, max_iter=2000)
    regression.fit(evidence(votes), labels, sample_weight=weights)
    coefficients, intercept = regression.coef_, regression.intercept_
    if len(regression.classes_) == 2:
        coefficients = np.concatenate([np.zeros_like(coefficients), coefficients])
        intercept = np.concatenate([[0.0], intercept])
    return np.ascontiguousarray(coefficients.T.astype(np.float32)), intercept.astype(np.float32)
