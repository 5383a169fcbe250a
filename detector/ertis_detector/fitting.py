"""Fits the classifier with scikit-learn, and says what it is worth on scenes left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.classifier import Classifier, both_votes, couple, evidence
from ertis_detector.fit_trees import fit_trees
from ertis_detector.networks import FEATURE_CAP, Committee
from ertis_detector.trees import Trees

Float32 = npt.NDArray[np.float32]
Strings = npt.NDArray[np.str_]
Rows = npt.NDArray[np.intp]

NUM_NETWORKS = 4
NUM_FOLDS, LEAST_FOLDS = 5, 3
HIDDEN = (128, 64)
_EPOCHS, _BATCH, _STEP, _WEIGHT_DECAY = 25, 256, 1e-3, 0.3
_LEAST_SCALE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Candidates with their labels.

    features : float32, shape (n, num_features)
    labels, groups : n strings each
        Rows of one group (one scene) hear the same clutter: they never stand on both sides of a
        fold.
    weights : shape (n,), or None
        How often each row is met where probabilities must come true; None for as often as here.
    """

    features: Float32
    labels: Sequence[str]
    groups: Sequence[str]
    weights: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A classifier and what it is worth on scenes left out.

    probabilities : float32, shape (n, num_classes)
        For each row of the fresh echoes, or of all if there are none: from networks and trees that
        met none of its group, and a law of probabilities fitted without it.
    """

    classifier: Classifier
    probabilities: Float32


def fit(
    taught: Echoes,
    fresh: Echoes | None = None,
    *,
    teaches: npt.NDArray[np.bool_] | None = None,
    num_networks: int = NUM_NETWORKS,
    num_folds: int = NUM_FOLDS,
    workers: int = 1,
) -> Fit:
    """Fit networks and trees to all rows that teach; make probabilities by what they say elsewhere.

    Parameters
    ----------
    taught : Echoes
    fresh : Echoes or None
        What the law of probabilities is fitted to, of groups that networks and trees have not met.
        None: what each fold of the taught says, with networks and trees of the others. Those have
        met a part (1 - 1 / num_folds) of the rows only, so that the law is a little too cautious.
    teaches : bool, one a taught row, or None
        Rows that networks and trees learn from; None for all. The law of probabilities is of all
        rows: it is asked of each echo, clear or not.
    num_networks, num_folds : int
        Of folds no more than there are groups.
    workers : int
        Processes; the result does not depend on it.

    Raises
    ------
    ValueError
        With fewer than two classes, fewer than three groups, or a class that only one fold has.
    """
    labels = np.asarray(taught.labels)
    teaching = np.ones(len(labels), bool) if teaches is None else teaches
    classes = tuple(str(name) for name in np.unique(labels[teaching]))
    if len(classes) < 2:
        raise ValueError(f"only {classes} among the labels: nothing to tell apart")
    judged = taught if fresh is None else fresh
    splits = folds(judged.groups, num_folds)
    known = [known[teaching[known]] for known, _ in splits] if fresh is None else []
    known.append(np.flatnonzero(teaching))
    for rows in known:
        _check(labels[rows], classes)
    voters = _learn(taught.features, labels, known, num_networks, workers)
    asked = [unseen for _, unseen in splits] if fresh is None else [np.arange(len(fresh.labels))]
    votes = np.zeros((len(judged.labels), 2 * len(classes)), np.float32)
    for unseen, voter in zip(asked, voters, strict=False):
        votes[unseen] = both_votes(*voter, judged.features[unseen])
    law, probabilities = _law(votes, judged, classes, splits)
    return Fit(Classifier(classes, *voters[-1], *law), probabilities)


def folds(groups: Sequence[str], num_folds: int = NUM_FOLDS) -> list[tuple[Rows, Rows]]:
    """Rows of all other folds, and of each; no group stands on both sides.

    Raises
    ------
    ValueError
        With fewer than three groups.
    """
    from sklearn.model_selection import GroupKFold

    num_folds = max(min(num_folds, len(set(groups))), LEAST_FOLDS)
    return list(GroupKFold(num_folds).split(groups, groups=groups))


def _check(labels: Strings, classes: Sequence[str]) -> None:
    if len(np.unique(labels)) < len(classes):
        raise ValueError(f"too few groups with each of {tuple(classes)}: record more")


def _learn(
    features: Float32, labels: Strings, known: Sequence[Rows], num_networks: int, workers: int
) -> list[tuple[Committee, Trees]]:
    """Networks and trees of each of some choices of rows."""
    from joblib import Parallel, delayed

    tasks = [delayed(fit_trees)(features[rows], labels[rows]) for rows in known]  # the longest
    tasks += [
        delayed(_network)(features[rows], labels[rows], seed)
        for rows in known
        for seed in range(num_networks)
    ]
    made = Parallel(n_jobs=workers)(tasks)
    forests, networks = made[: len(known)], made[len(known) :]
    return [
        (_committee(features[rows], networks[i * num_networks : (i + 1) * num_networks]), trees)
        for i, (rows, trees) in enumerate(zip(known, forests, strict=True))
    ]


def _law(
    votes: Float32, echoes: Echoes, classes: tuple[str, ...], splits: Sequence[tuple[Rows, Rows]]
) -> tuple[tuple[Float32, Float32], Float32]:
    """Coupling and offset by all rows, and each row's probabilities by the folds it is not of."""
    labels = np.asarray(echoes.labels)
    weights = np.ones(len(labels)) if echoes.weights is None else echoes.weights
    named = np.isin(labels, classes)

    def fitted(rows: Rows) -> tuple[Float32, Float32]:
        told = rows[named[rows]]
        _check(labels[told], classes)
        return _coupling(votes[told], labels[told], weights[told])

    probabilities = np.zeros((len(labels), len(classes)), np.float32)
    for known, unseen in splits:
        probabilities[unseen] = couple(votes[unseen], *fitted(known))
    return fitted(np.arange(len(labels))), probabilities


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
