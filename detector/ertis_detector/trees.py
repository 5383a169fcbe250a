"""Boosted decision trees, applied by numpy: all questions of all trees at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ertis_detector.networks import softmax

Float32 = npt.NDArray[np.float32]

MAX_LEAVES = 32  # bits of a mask


@dataclass(frozen=True, eq=False)
class Trees:
    """A forest whose leaves add up, one sum a class.

    Rather than walk down each tree, every split is asked; one that is answered "more" rules out
    the leaves on its left, and the leftmost leaf that is left is the tree's (Lucchese et al.,
    SIGIR 2015, "QuickScorer").

    feature : uint8, shape (num_splits,)
        Of all trees, one after the other.
    threshold : float32, shape (num_splits,)
        At or under it the way goes left.
    mask : uint32, shape (num_splits,)
        Bit ``i`` is 0 for leaf ``i`` on the left; leaves are counted from the left.
    first : int32, shape (num_trees,)
        Where each tree's splits begin; each has one at least.
    leaves : float32, shape (num_trees, MAX_LEAVES)
        Tree ``t`` adds to class ``t % num_classes``.
    baseline : float32, shape (num_classes,)
    """

    feature: npt.NDArray[np.uint8]
    threshold: Float32
    mask: npt.NDArray[np.uint32]
    first: npt.NDArray[np.int32]
    leaves: Float32
    baseline: Float32

    def votes(self, features: Float32) -> Float32:
        """Probabilities, shape (n, num_classes), from features (n, num_features)."""
        return softmax(self.scores(features))

    def scores(self, features: Float32) -> Float32:
        """Sums of leaves, shape (n, num_classes)."""
        feature, threshold, left = self._questions
        num_trees = self.first.size
        # "clip" only tells take that it need not check: indices are of features by construction.
        is_more = features.take(feature, 1, mode="clip") > threshold
        answers = (is_more * left).reshape(len(features), -1, num_trees)
        ruled_out = np.bitwise_or.reduce(answers, axis=1)
        lowest = ~ruled_out & (ruled_out + np.uint32(1))
        leaf = np.frexp(lowest.astype(np.float32))[1] - 1  # a power of two: exact
        values = self.leaves.take(leaf + self.leaves.shape[1] * np.arange(num_trees))
        rounds = values.reshape(len(features), -1, self.baseline.size)
        return np.asarray(np.ones(rounds.shape[1], np.float32) @ rounds + self.baseline)

    @cached_property
    def _questions(self) -> tuple[npt.NDArray[np.intp], Float32, npt.NDArray[np.uint32]]:
        """Feature, threshold and leaves on the left: of all trees' first splits, of their second.

        Whole rows add up fast. A tree of fewer splits asks what rules nothing out.
        """
        sizes = np.diff(self.first, append=self.feature.size)
        at = np.arange(self.feature.size) - np.repeat(self.first, sizes)
        at *= sizes.size
        at += np.repeat(np.arange(sizes.size), sizes)
        count = sizes.max() * sizes.size
        feature, threshold = np.zeros(count, np.intp), np.zeros(count, np.float32)
        left = np.zeros(count, np.uint32)
        feature[at], threshold[at], left[at] = self.feature, self.threshold, ~self.mask
        return feature, threshold, left
