"""Fits boosted trees with scikit-learn, and takes them out as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.trees import MAX_NODES, Trees

Float32 = npt.NDArray[np.float32]

NUM_ROUNDS = 110
_LEARNING_RATE, _MAX_LEAVES, _MIN_LEAF, _L2 = 0.12, 24, 20, 1.0
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
        max_leaf_nodes=_MAX_LEAVES,
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
    """The nodes of all trees in one row; of two classes the first gets trees of nothing."""
    parts: dict[str, list[npt.NDArray[Any]]] = {
        name: [] for name in ("feature", "threshold", "left", "right", "value")
    }
    roots, first = [], 0
    for rounds in boosting._predictors:
        nodes_of = [predictor.nodes for predictor in rounds]
        if num_classes == 2:
            nothing = np.zeros(1, nodes_of[0].dtype)
            nothing["is_leaf"] = 1
            nodes_of = [nothing, *nodes_of]
        for nodes in nodes_of:
            if len(nodes) > MAX_NODES:
                raise RuntimeError(f"a tree of {len(nodes)} nodes, expected {MAX_NODES} at most")
            leaf = nodes["is_leaf"].astype(bool)
            parts["feature"].append(np.where(leaf, 0, nodes["feature_idx"]))
            parts["threshold"].append(np.where(leaf, 0.0, nodes["num_threshold"]))
            parts["left"].append(np.where(leaf, 0, nodes["left"]))
            parts["right"].append(np.where(leaf, 0, nodes["right"]))
            parts["value"].append(np.where(leaf, nodes["value"], 0.0))
            roots.append(first)
            first += len(nodes)
    base = np.ravel(boosting._baseline_prediction)
    joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
    return Trees(
        joined["feature"].astype(np.uint8),
        _at_or_under(joined["threshold"]),
        joined["left"].astype(np.uint8),
        joined["right"].astype(np.uint8),
        joined["value"].astype(np.float32),
        np.array(roots, np.int32),
        (base if num_classes > 2 else np.array([0.0, *base])).astype(np.float32),
    )


def _at_or_under(threshold: npt.NDArray[np.float64]) -> Float32:
    """Largest float32 not above each threshold: float32 features compare as before."""
    rounded = threshold.astype(np.float32)
    above = rounded.astype(np.float64) > threshold
    return np.where(above, np.nextafter(rounded, np.float32(-np.inf)), rounded)
