"""Which pings are learnt from, and which are asked: random folds, and one group left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.errors import EvaluationError


@dataclass(frozen=True, slots=True, eq=False)
class Fold:
    """Rows to learn from and rows to ask, and what the latter are called."""

    name: str
    kept: npt.NDArray[np.intp]
    left_out: npt.NDArray[np.intp]


def random_folds(labels: Sequence[str], num_folds: int, rng: np.random.Generator) -> list[Fold]:
    """Deal rows out to folds at random, each label evenly.

    Raises
    ------
    EvaluationError
        If a label has fewer rows than two, or there are fewer folds than two.
    """
    if num_folds < 2:
        raise EvaluationError(f"{num_folds} folds: expected two at least")
    names = np.asarray(labels)
    fold_of = np.empty(names.size, np.intp)
    dealt = 0
    for name in np.unique(names):
        rows = np.flatnonzero(names == name)
        if rows.size < 2:
            raise EvaluationError(f"label {name} stands on one ping only: record more of it")
        rng.shuffle(rows)
        # Going on where the last label ended keeps the folds of one size.
        fold_of[rows] = (dealt + np.arange(rows.size)) % num_folds
        dealt += rows.size
    return [
        Fold(f"fold {number + 1}", np.flatnonzero(~chosen), np.flatnonzero(chosen))
        for number in range(num_folds)
        if (chosen := fold_of == number).any()
    ]


def leave_one_out(groups: Sequence[str]) -> list[Fold]:
    """One fold a group, in order of first appearance: it is asked by who heard all others.

    Raises
    ------
    EvaluationError
        If there is one group only.
    """
    names = np.asarray(groups)
    distinct = list(dict.fromkeys(groups))
    if len(distinct) < 2:
        raise EvaluationError(
            f"all pings are of {distinct[0] if distinct else 'no group'}: leaving one group out "
            "needs two at least"
        )
    return [
        Fold(name, np.flatnonzero(names != name), np.flatnonzero(names == name))
        for name in distinct
    ]
