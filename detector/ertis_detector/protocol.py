"""The strict protocol: told the range, is a landmark there, and which; on one set of splits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import NONE
from ertis_detector.errors import EvaluationError
from ertis_detector.intervals import Interval, cluster_bootstrap
from ertis_detector.method import Method
from ertis_detector.splits import Fold, leave_one_out, random_folds

Float = npt.NDArray[np.float64]

REPEATS = 20  # the paper's "cross-validated 20 times"
FOLDS = 10
TASKS = ("detection", "size", "overall")
RANDOM, ENVIRONMENT, SESSION = "random folds", "environment left out", "session left out"


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """What is known of each ping; n names each.

    session : distinct in each environment, so that it is a cluster of its own
    """

    label: tuple[str, ...]
    environment: tuple[str, ...]
    session: tuple[str, ...]

    def __post_init__(self) -> None:
        landmarks = set(self.label) - {NONE}
        if len(landmarks) < 2 or NONE not in self.label:
            raise EvaluationError(
                f"labels {', '.join(sorted(set(self.label))) or 'none at all'}: the protocol needs "
                f"two landmarks at least, and pings labelled {NONE!r}"
            )

    @property
    def classes(self) -> tuple[str, ...]:
        """The landmarks' labels in order, then ``none``."""
        return (*sorted(set(self.label) - {NONE}), NONE)

    @property
    def truth(self) -> npt.NDArray[np.intp]:
        """Index of each label in ``classes``."""
        return np.array([self.classes.index(one) for one in self.label])


@dataclass(frozen=True, slots=True)
class Accuracy:
    """A share of pings that were told rightly.

    spread : float
        Standard deviation over repeats, or over the groups left out.
    interval : (low, high)
        95 %, whole sessions drawn again; (nan, nan) with one session only.
    """

    mean: float
    spread: float
    interval: Interval


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """How one method did on one way of splitting.

    right : float, shape (num_pings, 3)
        Share of repeats in which detection, size and all were right; size is NaN for ``none``.
    accuracies : one a task, in the order of ``TASKS``
    detection_confusion : shape (2, 2)
        Pings a repeat; truth down (landmark, none), said across.
    size_confusion : shape (num_sizes, num_sizes)
    overall_confusion : shape (num_classes, num_classes)
    by_group : name of each group left out -> its three accuracies; empty for random folds
    """

    right: Float
    accuracies: tuple[Accuracy, ...]
    detection_confusion: Float
    size_confusion: Float
    overall_confusion: Float
    by_group: dict[str, tuple[float, ...]]


def splits(labels: Labels, repeats: int, folds: int, seed: int) -> dict[str, list[list[Fold]]]:
    """Each way of splitting, as passes through all pings; the same for every method.

    Raises
    ------
    EvaluationError
        If there are too few pings of a label.
    """
    rng = np.random.default_rng(seed)
    ways = {RANDOM: [random_folds(labels.label, folds, rng) for _ in range(repeats)]}
    if len(set(labels.environment)) > 1:
        ways[ENVIRONMENT] = [leave_one_out(labels.environment)]
    if len(set(labels.session)) > 1:
        ways[SESSION] = [leave_one_out(labels.session)]
    return ways


@dataclass(frozen=True, slots=True, eq=False)
class Contestant:
    """A method, and what its ``prepare`` made of each ping, shape (num_pings, ...)."""

    method: Method
    prepared: npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class PassRunner:
    """Runs one pass of one contestant; sent to each worker process once, with all its arrays."""

    contestants: Sequence[Contestant]
    labels: Labels

    def __call__(self, task: tuple[int, list[Fold]]) -> Float:
        """Probabilities of every ping from fits that did not hear it, shape (n, num_classes)."""
        number, folds = task
        method, prepared = self.contestants[number].method, self.contestants[number].prepared
        names, classes = np.asarray(self.labels.label), self.labels.classes
        probabilities = np.zeros((names.size, len(classes)))
        for fold in folds:
            method.fit(prepared[fold.kept], names[fold.kept].tolist())
            order = [classes.index(name) for name in method.classes]
            told = method.predict(prepared[fold.left_out])
            probabilities[fold.left_out[:, None], order] = told
        return probabilities


Deal = Callable[[PassRunner, Sequence[tuple[int, list[Fold]]]], Iterable[Float]]


def run_protocol(
    contestants: Sequence[Contestant],
    labels: Labels,
    ways: dict[str, list[list[Fold]]],
    deal: Deal = map,
) -> list[dict[str, Outcome]]:
    """Fit and ask every method on every split; outcomes by way of splitting, one a contestant.

    Parameters
    ----------
    contestants, labels
    ways
        From ``splits``.
    deal
        ``map``, or one that keeps its order and uses several processes.
    """
    tasks = [
        (number, folds)
        for number in range(len(contestants))
        for passes in ways.values()
        for folds in passes
    ]
    told = iter(deal(PassRunner(contestants, labels), tasks))
    return [
        {
            name: outcome([next(told) for _ in passes], labels, None if name == RANDOM else passes)
            for name, passes in ways.items()
        }
        for _ in contestants
    ]


def outcome(
    passes: Sequence[Float], labels: Labels, left_out: Sequence[Sequence[Fold]] | None = None
) -> Outcome:
    """Judge what was told.

    A landmark is said where ``none`` has at most one half; its size is the most probable one,
    asked of every ping with a landmark, whether detected or not.

    Parameters
    ----------
    passes : probabilities of all pings, shape (num_pings, num_classes), one a repeat
    left_out : the folds of each pass, if they are groups whose accuracies mean something
    """
    num_classes = len(labels.classes)
    none = num_classes - 1
    truth = labels.truth
    all_right = []
    confusion = np.zeros((num_classes, num_classes))
    sizes = np.zeros((none, none))
    for probabilities in passes:
        size = probabilities[:, :-1].argmax(axis=1)
        said = np.where(probabilities[:, -1] > 0.5, none, size)
        np.add.at(confusion, (truth, said), 1 / len(passes))
        landmark = truth != none
        np.add.at(sizes, (truth[landmark], size[landmark]), 1 / len(passes))
        size_right = np.where(landmark, size == truth, np.nan)
        all_right.append(
            np.column_stack([(said == none) == (truth == none), size_right, said == truth])
        )
    stacked = np.stack(all_right)
    right = stacked.mean(axis=0)
    by_group = {}
    if left_out is not None:
        by_group = {
            fold.name: tuple(float(v) for v in _means(right[fold.left_out])) for fold in left_out[0]
        }
    groups = np.array(list(by_group.values())) if by_group else _means_of(stacked)
    accuracies = tuple(
        Accuracy(
            float(_means(right)[task]),
            _spread(groups[:, task]),
            cluster_bootstrap(right[:, task], labels.session),
        )
        for task in range(len(TASKS))
    )
    detection = np.array(
        [
            [confusion[:none, :none].sum(), confusion[:none, none].sum()],
            [confusion[none, :none].sum(), confusion[none, none]],
        ]
    )
    return Outcome(right, accuracies, detection, sizes, confusion, by_group)


def _means(right: Float) -> Float:
    counted = ~np.isnan(right)
    sums = np.where(counted, right, 0).sum(axis=0)
    with np.errstate(invalid="ignore"):  # a group without a landmark has no size to be right in
        return np.asarray(sums / counted.sum(axis=0))


def _means_of(stacked: Float) -> Float:
    return np.array([_means(one) for one in stacked])


def _spread(values: Float) -> float:
    kept = values[~np.isnan(values)]
    return float(kept.std(ddof=1)) if kept.size > 1 else float("nan")


def gain(ours: Outcome, theirs: Outcome, task: int, labels: Labels) -> Accuracy:
    """By how much one method is better than another on the same pings, paired; spread is NaN."""
    difference = ours.right[:, task] - theirs.right[:, task]
    mean = float(np.nanmean(difference))
    return Accuracy(mean, float("nan"), cluster_bootstrap(difference, labels.session))
