"""Linear one-versus-one SVM: fitted by scikit-learn, applied by numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]
_MARGIN_CAP = 3.0  # a margin beyond it says nothing more


@dataclass(frozen=True, slots=True, eq=False)
class OneVersusOne:
    """A linear classifier of every pair of classes.

    classes : tuple of str
    mean, scale : float32, shape (num_features,)
        Features are standardised by them.
    weights, bias : float32, shapes (num_pairs, num_features) and (num_pairs,)
        Pairs in the order of ``itertools.combinations``; a positive margin votes for the first.
    coupling, offset : float32, shapes (num_pairs, num_classes) and (num_classes,)
        Log-odds of each class from the clipped margins, fitted on scenes left out.
    """

    classes: tuple[str, ...]
    mean: Float32
    scale: Float32
    weights: Float32
    bias: Float32
    coupling: Float32
    offset: Float32

    def decision_margins(self, features: Float32) -> Float32:
        """Raw margin of each pair, shape (n, num_pairs), from features (n, num_features)."""
        return np.asarray((features - self.mean) / self.scale @ self.weights.T + self.bias)

    def probabilities(self, features: Float32) -> Float32:
        """Calibrated probability of each class, shape (n, num_classes); rows sum to 1."""
        return couple(self.decision_margins(features), self.coupling, self.offset)

    def predict(self, features: Float32) -> list[str]:
        """The most probable class of each row."""
        return [self.classes[i] for i in self.probabilities(features).argmax(axis=1)]


def couple(margins: Float32, coupling: Float32, offset: Float32) -> Float32:
    """Margins of pairs to probabilities of classes: multinomial logistic regression."""
    return softmax(np.clip(margins, -_MARGIN_CAP, _MARGIN_CAP) @ coupling + offset)


def softmax(values: Float32) -> Float32:
    """Rows to probabilities."""
    lifted = np.exp(values - values.max(axis=1, keepdims=True))
    return np.asarray(lifted / lifted.sum(axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A classifier and what cross-validation says of it.

    probabilities : float32, shape (n, num_classes)
        For each training row, from pair classifiers that saw none of its scene, and a coupling
        fitted without it.
    """

    classifier: OneVersusOne
    probabilities: Float32


def fit(
    features: Float32,
    labels: Sequence[str],
    groups: Sequence[str],
    *,
    penalty: float = 0.1,
    num_folds: int = 5,
) -> Fit:
    """Fit on all rows; couple by what each fold of unseen groups says.

    Parameters
    ----------
    features : float32, shape (n, num_features)
    labels, groups : n strings each
        Rows of one group (one scene) never stand on both sides of a fold.
    penalty : float
        C of the SVM.
    num_folds : int

    Raises
    ------
    ValueError
        With fewer than two classes, or fewer groups than folds.
    """
    from sklearn.model_selection import GroupKFold

    label_array = np.asarray(labels)
    classes = tuple(sorted(set(labels)))
    if len(classes) < 2:
        raise ValueError(f"training needs two classes at least, met {', '.join(classes) or 'none'}")
    for name in classes:
        scenes = {group for group, label in zip(groups, labels, strict=True) if label == name}
        if len(scenes) < 2:
            raise ValueError(f"training needs {name} in two scenes at least, met one")
    if len(set(groups)) < num_folds:
        raise ValueError(f"training needs {num_folds} scenes at least, met {len(set(groups))}")
    folds = list(GroupKFold(num_folds).split(features, label_array, np.asarray(groups)))
    margins = np.zeros((len(labels), len(classes) * (len(classes) - 1) // 2), np.float32)
    for kept, left_out in folds:
        part = _Pairs.fit(features[kept], label_array[kept], classes, penalty)
        margins[left_out] = part.margins(features[left_out])
    unseen = np.zeros((len(labels), len(classes)), np.float32)
    for kept, left_out in folds:
        unseen[left_out] = couple(
            margins[left_out], *_coupling(margins[kept], label_array[kept], classes)
        )
    whole = _Pairs.fit(features, label_array, classes, penalty)
    coupling, offset = _coupling(margins, label_array, classes)
    classifier = OneVersusOne(
        classes, whole.mean, whole.scale, whole.weights, whole.bias, coupling, offset
    )
    return Fit(classifier, unseen)


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    mean: Float32
    scale: Float32
    weights: Float32
    bias: Float32

    @classmethod
    def fit(
        cls,
        features: Float32,
        labels: npt.NDArray[np.str_],
        classes: tuple[str, ...],
        penalty: float,
    ) -> _Pairs:
        from sklearn.svm import LinearSVC

        mean = features.mean(axis=0)
        scale = np.maximum(features.std(axis=0), np.float32(1e-3))
        scaled = (features - mean) / scale
        weights, bias = [], []
        for first, second in combinations(classes, 2):
            chosen = (labels == first) | (labels == second)
            svm = LinearSVC(C=penalty, class_weight="balanced", dual=False)
            # True is scikit-learn's second class, the one of positive margins.
            svm.fit(scaled[chosen], labels[chosen] == first)
            weights.append(svm.coef_[0])
            bias.append(svm.intercept_[0])
        return cls(mean, scale, np.array(weights, np.float32), np.array(bias, np.float32))

    def margins(self, features: Float32) -> Float32:
        return np.asarray((features - self.mean) / self.scale @ self.weights.T + self.bias)


def _coupling(
    margins: Float32, labels: npt.NDArray[np.str_], classes: tuple[str, ...]
) -> tuple[Float32, Float32]:
    from sklearn.linear_model import LogisticRegression

    regression = LogisticRegression(C=1.0, max_iter=2000)
    regression.fit(np.clip(margins, -_MARGIN_CAP, _MARGIN_CAP), labels)
    coefficients, intercept = regression.coef_, regression.intercept_
    if len(classes) == 2:  # scikit-learn keeps one row then: the log-odds of the second class
        coefficients = np.concatenate([np.zeros_like(coefficients), coefficients])
        intercept = np.concatenate([[0.0], intercept])
    return np.ascontiguousarray(coefficients.T.astype(np.float32)), intercept.astype(np.float32)
