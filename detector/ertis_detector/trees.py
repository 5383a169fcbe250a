"""Boosted decision trees, applied by numpy: all trees of all rows one step at a time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.networks import softmax

Float32 = npt.NDArray[np.float32]

MAX_NODES = 255  # of one tree


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """A forest whose leaves add up, one sum a class.

    Nodes of all trees stand in one row, each tree's root first.

    feature : uint8, shape (num_nodes,)
    threshold : float32, shape (num_nodes,)
        At or under it the way goes left.
    left, right : uint8, shape (num_nodes,)
        Children, counted from the root of their tree; 0 for a leaf.
    value : float32, shape (num_nodes,)
        Of leaves; 0 elsewhere.
    roots : int32, shape (num_trees,)
        Tree ``t`` adds to class ``t % num_classes``.
    baseline : float32, shape (num_classes,)
    """

    feature: npt.NDArray[np.uint8]
    threshold: Float32
    left: npt.NDArray[np.uint8]
    right: npt.NDArray[np.uint8]
    value: Float32
    roots: npt.NDArray[np.int32]
    baseline: Float32

    def votes(self, features: Float32) -> Float32:
        """Probabilities, shape (n, num_classes), from features (n, num_features)."""
        return softmax(self.scores(features))

    def scores(self, features: Float32) -> Float32:
        """Sums of leaves, shape (n, num_classes)."""
        num_rows = len(features)
        root = np.broadcast_to(self.roots, (num_rows, self.roots.size))
        at, row = root, np.arange(num_rows)[:, None]
        for _ in range(MAX_NODES):
            goes_left = features[row, self.feature[at]] <= self.threshold[at]
            child = np.where(goes_left, self.left[at], self.right[at])
            if not child.any():
                break
            at = np.where(child > 0, root + child, at)
        leaves = self.value[at].reshape(num_rows, -1, self.baseline.size)
        return np.asarray(leaves.sum(axis=1, dtype=np.float32) + self.baseline)
