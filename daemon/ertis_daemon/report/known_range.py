"""The strict protocol on a labelled data set: read, prepare, run every method, sweep choices."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ertis_daemon.report.known_range_data import Prepared, Preparer, labels_of, usable_rows
from ertis_daemon.workers import Workers
from ertis_detector.method import Method
from ertis_detector.paper import PaperMethod
from ertis_detector.paper_choices import PaperChoices, alternatives
from ertis_detector.protocol import (
    ENVIRONMENT,
    FOLDS,
    RANDOM,
    REPEATS,
    Accuracy,
    Contestant,
    Labels,
    Outcome,
    gain,
    run_protocol,
    splits,
)
from ertis_driver.dataset import Dataset

PAPER_FIGURES = {"detection": (89.1, 0.8), "size": (67.2, 1.3), "overall": (73.8, 0.9)}  # percent


@dataclass(frozen=True, slots=True)
class KnownRangeSpec:
    """How the protocol is run; the same spec on the same data gives the same figures.

    choices : what the paper leaves open
    repeats, folds : of the random folds
    sweep : every alternative of every choice, too
    """

    choices: PaperChoices = field(default_factory=PaperChoices)
    repeats: int = REPEATS
    folds: int = FOLDS
    seed: int = 1
    sweep: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SweptChoice:
    """One choice made otherwise.

    change : ``name=value``
    split : the environment left out, or random folds if there is but one environment
    outcome : by that split
    gains : of each task over the default, paired
    """

    change: str
    split: str
    outcome: Outcome
    gains: tuple[Accuracy, ...]


@dataclass(frozen=True, slots=True, eq=False)
class KnownRangeReport:
    """What came out.

    sources, chirps : as the recordings say, distinct
    skipped : pings whose label has no range
    outcomes : of each method, by way of splitting
    sweep : empty if it was not asked for
    """

    folder: str
    manifest_hash: str
    sources: tuple[str, ...]
    chirps: tuple[str, ...]
    labels: Labels
    skipped: int
    spec: KnownRangeSpec
    methods: tuple[str, ...]
    outcomes: tuple[dict[str, Outcome], ...]
    sweep: tuple[SweptChoice, ...]

    @property
    def guesses(self) -> tuple[float, float, float]:
        """Accuracies of always saying what is commonest, in the order of the tasks."""
        counts = Counter(self.labels.label)
        none = counts.pop("none")
        landmarks = sum(counts.values())
        total = landmarks + none
        commonest = max(counts.values())
        return max(landmarks, none) / total, commonest / landmarks, max(commonest, none) / total


def evaluate_known_range(
    dataset: Dataset,
    methods: Sequence[Method],
    spec: KnownRangeSpec,
    workers: int = 1,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> KnownRangeReport:
    """Run every method on every split.

    Parameters
    ----------
    dataset
    methods
        The first is the one that others are compared with.
    spec
    workers : int
        Processes.
    progress
        Called with what is being done, how much of it is done, and of how much.

    Raises
    ------
    DatasetError, RecordingError, DetectorError
        If the data do not carry the protocol.
    """
    rows = usable_rows(dataset)
    labels = labels_of(rows)
    ways = splits(labels, spec.repeats, spec.folds, spec.seed)
    swept = alternatives(spec.choices) if spec.sweep else []
    heard_otherwise = (spec.choices, *swept) if swept else ()
    hearing = [
        PaperMethod(one) for one in dict.fromkeys(one.preparation for one in heard_otherwise)
    ]
    reading = Workers(workers, lambda done, of: progress("pings read", done, of))
    heard = list(reading(Preparer(dataset, [*methods, *hearing]), rows))
    contestants = [Contestant(method, _stack(heard, n)) for n, method in enumerate(methods)]
    fitting = Workers(workers, lambda done, of: progress("fits of all pings", done, of))
    outcomes = run_protocol(contestants, labels, ways, fitting)
    table: list[SweptChoice] = []
    if swept:
        arrays = {
            one.choices.preparation: _stack(heard, len(methods) + n)
            for n, one in enumerate(hearing)
        }
        sweeping = Workers(workers, lambda done, of: progress("fits of the sweep", done, of))
        table = _sweep(spec, swept, arrays, labels, sweeping)
    return KnownRangeReport(
        folder=str(dataset.folder),
        manifest_hash=dataset.manifest_hash,
        sources=tuple(sorted({one.source for one in heard})),
        chirps=tuple(sorted({one.chirp for one in heard})),
        labels=labels,
        skipped=len(dataset.rows) - len(rows),
        spec=spec,
        methods=tuple(method.name for method in methods),
        outcomes=tuple(outcomes),
        sweep=tuple(table),
    )


def _stack(heard: Sequence[Prepared], number: int) -> Any:
    return np.stack([one.arrays[number] for one in heard])


def _sweep(
    spec: KnownRangeSpec,
    swept: Sequence[PaperChoices],
    arrays: dict[PaperChoices, Any],
    labels: Labels,
    workers: Workers,
) -> list[SweptChoice]:
    ways = splits(labels, spec.repeats, spec.folds, spec.seed)
    told = ENVIRONMENT if ENVIRONMENT in ways else RANDOM  # rooms that nobody heard, if there are
    default, *others = run_protocol(
        [Contestant(PaperMethod(one), arrays[one.preparation]) for one in (spec.choices, *swept)],
        labels,
        {told: ways[told]},
        workers,
    )
    return [
        SweptChoice(
            one.difference(spec.choices),
            told,
            outcomes[told],
            tuple(gain(outcomes[told], default[told], task, labels) for task in range(3)),
        )
        for one, outcomes in zip(swept, others, strict=True)
    ]
