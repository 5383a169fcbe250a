"""Which landmark an echo is of, if any: networks and trees vote; votes become probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.networks import Committee, softmax
from ertis_detector.trees import Trees

Float32 = npt.NDArray[np.float32]
_BLOCK = 1000  # rows; trees take 0.3 MB for each
_LEAST_VOTE = 1e-4  # smaller ones were never put to the test


@dataclass(frozen=True, slots=True, eq=False)
class Classifier:
    """A committee of networks, trees, and the law that makes probabilities of their votes.

    Either alone is now and then sure of a false landmark; seldom are both of the same. The law
    hears each of them, so that their disagreement counts as doubt.

    classes : tuple of str
    committee : Committee
    trees : Trees
    coupling, offset : float32, shapes (2 * num_classes, num_classes) and (num_classes,)
        Log-odds of each class from the votes' logarithms, fitted on scenes left out.
    """

    classes: tuple[str, ...]
    committee: Committee
    trees: Trees
    coupling: Float32
    offset: Float32

    def probabilities(self, features: Float32) -> Float32:
        """Calibrated probability of each class, shape (n, num_classes); rows sum to 1."""
        return couple(self.votes(features), self.coupling, self.offset)

    def votes(self, features: Float32) -> Float32:
        """What networks and trees say, shape (n, 2 * num_classes)."""
        return both_votes(self.committee, self.trees, features)

    def predict(self, features: Float32) -> list[str]:
        """The most probable class of each row."""
        return [self.classes[i] for i in self.probabilities(features).argmax(axis=1)]


def both_votes(committee: Committee, trees: Trees, features: Float32) -> Float32:
    """Probabilities by the networks, then by the trees; shape (n, 2 * num_classes)."""
    if len(features) > _BLOCK:
        blocks = np.array_split(features, len(features) // _BLOCK + 1)
        return np.concatenate([both_votes(committee, trees, some) for some in blocks])
    return np.concatenate([committee.votes(features), trees.votes(features)], axis=1)


def evidence(votes: Float32) -> Float32:
    """Logarithms of votes against their mean over the classes, of networks and trees each."""
    logarithm = np.log(np.maximum(votes, _LEAST_VOTE)).reshape(len(votes), 2, -1)
    centred = logarithm - logarithm.mean(axis=2, keepdims=True)
    return np.asarray(centred.reshape(votes.shape))


def couple(votes: Float32, coupling: Float32, offset: Float32) -> Float32:
    """Votes to probabilities: multinomial logistic regression."""
    return softmax(evidence(votes) @ coupling + offset)
