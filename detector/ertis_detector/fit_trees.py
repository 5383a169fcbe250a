"""Fits boosted trees with scikit-learn, and takes them out as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.trees import MAX_LEAVES, Trees

Float32 = npt.NDArray[np.float32]

NUM_ROUNDS = 150
_LEARNING_RATE, _LEAVES, _MIN_LEAF, _L2 = 0.09, 32, 20, 1.0
_SAMPLE = 200  # rows on which both ways of applying trees are compared
_GAP = 1e-2  # of scores
_UNLIKELY = -20.0  # a logarithm of a probability; under it rounding counts


def fit_trees(
    features: Float32, labels: npt.NDArray[np.str_], *, num_rounds: int = NUM_ROUNDS, seed: int = 0
) -> Trees:
    """Boosted trees.

    Parameters
    ----------
    features : float32, shape (n, num_features)
        At most 256 of them.
    labels : shape (n,)
        Classes are their sorted names.

    Raises
    ------
    RuntimeError
        If scikit-learn keeps its trees in another way than this can read.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier
    from threadpoolctl import threadpool_limits

    boosting = HistGradientBoostingClassifier(
        max_iter=num_rounds,
        learning_rate=_LEARNING_RATE,
        max_leaf_nodes=_LEAVES,
        min_samples_leaf=_MIN_LEAF,
        l2_regularization=_L2,
        early_stopping=False,
        random_state=seed,
    )
    with threadpool_limits(
        1
    ):  # its threads wait for each other by spinning, on busy cores for long
        boosting.fit(features, labels)
    trees = _arrays(boosting, len(boosting.classes_))
    some = features[:: max(len(features) // _SAMPLE, 1)]
    theirs = np.log(np.maximum(boosting.predict_proba(some), 1e-300))
    ours = np.log(np.maximum(trees.votes(some).astype(np.float64), 1e-300))
    if np.max(np.where(theirs > _UNLIKELY, np.abs(ours - theirs), 0)) > _GAP:
        raise RuntimeError(
            "scikit-learn applies its trees otherwise than they read here: use a version between "
            "1.4 and the newest that this was tried with"
        )
    return trees


def _arrays(boosting: Any, num_classes: int) -> Trees:
    """All trees' splits in one row; of two classes the first gets trees of nothing."""
    feature: list[int] = []
    threshold: list[float] = []
    mask: list[int] = []
    first: list[int] = []
    leaves: list[list[float]] = []
    for rounds in boosting._predictors:
        nodes_of = [predictor.nodes for predictor in rounds]
        for nodes in [None, *nodes_of] if num_classes == 2 else nodes_of:
            first.append(len(feature))
            values: list[float] = []
            if nodes is not None:
                _take(nodes, 0, values, feature, threshold, mask)
            if (
                len(feature) == first[-1]
            ):  # a tree of one leaf asks something that rules nothing out
                feature.append(0)
                threshold.append(0.0)
                mask.append(0xFFFFFFFF)
            if len(values) > MAX_LEAVES:
                raise RuntimeError(f"a tree of {len(values)} leaves, expected {MAX_LEAVES} at most")
            leaves.append(values + [0.0] * (MAX_LEAVES - len(values)))
    base = np.ravel(boosting._baseline_prediction)
    return Trees(
        np.array(feature, np.uint8),
        _at_or_under(np.array(threshold)),
        np.array(mask, np.uint32),
        np.array(first, np.int32),
        np.array(leaves, np.float32),
        (base if num_classes > 2 else np.array([0.0, *base])).astype(np.float32),
    )


def _take(
    nodes: Any,
    at: int,
    values: list[float],
    feature: list[int],
    threshold: list[float],
    mask: list[int],
) -> None:
    """Take splits and leaves of the subtree at a node, leaves from the left."""
    node = nodes[at]
    if node["is_leaf"]:
        values.append(float(node["value"]))
        return
    place, first_leaf = len(feature), len(values)
    feature.append(int(node["feature_idx"]))
    threshold.append(float(node["num_threshold"]))
    mask.append(0)
    _take(nodes, int(node["left"]), values, feature, threshold, mask)
    ruled_out = (1 << len(values)) - (1 << first_leaf)
    mask[place] = 0xFFFFFFFF & ~ruled_out
    _take(nodes, int(node["right"]), values, feature, threshold, mask)


def _at_or_under(threshold: npt.NDArray[np.float64]) -> Float32:
    """Largest float32 not above each threshold: float32 features compare as before."""
    rounded = threshold.astype(np.float32)
    above = rounded.astype(np.float64) > threshold
    return np.where(above, np.nextafter(rounded, np.float32(-np.inf)), rounded)
