"""The strict protocol: what is counted, and that nobody is asked what he has learnt."""

import numpy as np
import pytest

from ertis_detector.errors import EvaluationError
from ertis_detector.protocol import (
    ENVIRONMENT,
    RANDOM,
    SESSION,
    Contestant,
    Labels,
    gain,
    outcome,
    run_protocol,
    splits,
)

CLASSES = ("r35", "r70", "none")


def some_labels(num_rooms=4, sessions=2, each=6):
    rows = [
        (CLASSES[i % 3], f"room {room}", f"room {room}/s{s}")
        for room in range(num_rooms)
        for s in range(sessions)
        for i in range(each)
    ]
    return Labels(*(tuple(column) for column in zip(*rows, strict=True)))


class Remembers:
    """Knows what it has met, by exact value; what it has not met is the first class to it."""

    name = "remembers"

    def prepare(self, ping):
        raise AssertionError("pings are prepared before")

    def fit(self, prepared, labels):
        self.classes = tuple(sorted(set(labels)))
        self._met = dict(zip(prepared[:, 0].tolist(), labels, strict=True))

    def predict(self, prepared):
        told = np.full((len(prepared), len(self.classes)), 0.05)
        for row, value in zip(told, prepared[:, 0].tolist(), strict=True):
            row[self.classes.index(self._met.get(value, self.classes[0]))] = 0.9
        return told


def test_a_landmark_is_detected_named_and_both():
    labels = Labels(
        ("r35", "r70", "none", "none", "r35"), ("a",) * 5, ("a/1", "a/1", "a/1", "a/2", "a/2")
    )
    told = np.array(
        [
            [0.6, 0.3, 0.1],  # detected, right
            [0.5, 0.4, 0.1],  # detected, wrong size
            [0.1, 0.1, 0.8],  # silent, right
            [0.4, 0.2, 0.4],  # false alarm
            [0.3, 0.1, 0.6],  # missed, though its size would be right
        ]
    )
    judged = outcome([told], labels)
    assert [one.mean for one in judged.accuracies] == pytest.approx([3 / 5, 2 / 3, 2 / 5])
    np.testing.assert_array_equal(judged.detection_confusion, [[2, 1], [1, 1]])
    np.testing.assert_array_equal(judged.size_confusion, [[2, 0], [1, 0]])
    np.testing.assert_array_equal(judged.overall_confusion, [[1, 0, 1], [1, 0, 0], [1, 0, 1]])
    assert np.isnan(judged.accuracies[0].spread)  # one pass spreads over nothing


def test_the_spread_is_over_repeats_and_confusions_are_pings_a_repeat():
    labels = Labels(("r35", "r70", "none", "r35"), ("a",) * 4, ("a/1", "a/1", "a/2", "a/2"))
    right = np.eye(3)[labels.truth] * 0.8 + 0.05
    wrong = np.roll(right, 1, axis=1)
    judged = outcome([right, wrong], labels)
    overall = judged.accuracies[2]
    assert overall.mean == pytest.approx(0.5)
    assert overall.spread == pytest.approx(np.std([0.0, 1.0], ddof=1))
    assert judged.overall_confusion.sum() == pytest.approx(4)


def test_knowing_the_room_helps_in_random_folds_and_nowhere_else():
    labels = some_labels()
    # One value a room and label: who has met the room's other pings knows them all.
    met = list(zip(labels.environment, labels.label, strict=True))
    values = [met.index(one) for one in met]
    ways = splits(labels, repeats=3, folds=4, seed=1)
    assert list(ways) == [RANDOM, ENVIRONMENT, SESSION]
    told = run_protocol([Contestant(Remembers(), np.array(values, float)[:, None])], labels, ways)[
        0
    ]
    assert told[RANDOM].accuracies[2].mean > 0.95
    assert told[SESSION].accuracies[2].mean == 1.0
    assert told[ENVIRONMENT].accuracies[2].mean == pytest.approx(1 / 3)  # "none", always
    assert set(told[ENVIRONMENT].by_group) == set(labels.environment)
    lost = gain(told[RANDOM], told[ENVIRONMENT], 2, labels)
    assert lost.mean > 0.6
    assert lost.interval[0] > 0.5


def test_nobody_is_asked_what_he_has_learnt():
    labels = some_labels()
    ways = splits(labels, repeats=2, folds=5, seed=3)
    every_ping_its_own = np.arange(len(labels.label), dtype=float)[:, None]
    for told in run_protocol([Contestant(Remembers(), every_ping_its_own)], labels, ways)[
        0
    ].values():
        assert told.accuracies[2].mean == pytest.approx(1 / 3)  # it knew none of them


def test_contestants_stand_before_the_same_splits_in_their_order():
    labels = some_labels()
    ways = splits(labels, repeats=2, folds=3, seed=1)
    knows = np.array([CLASSES.index(one) for one in labels.label], float)[:, None]
    told = run_protocol(
        [Contestant(Remembers(), knows * 0), Contestant(Remembers(), knows)], labels, ways
    )
    blind, seeing = (one[RANDOM].accuracies[2].mean for one in told)
    assert seeing == 1.0
    assert blind < 0.5


def test_what_cannot_be_split_is_left_out_and_what_cannot_be_judged_refused():
    alone = Labels(("r35", "r70", "none") * 4, ("lab",) * 12, ("lab/1",) * 12)
    assert list(splits(alone, 1, 2, 1)) == [RANDOM]
    for wrong in (("r35", "none"), ("r35", "r70"), ()):
        with pytest.raises(EvaluationError, match="needs two landmarks at least, and pings"):
            Labels(wrong, ("a",) * len(wrong), ("a",) * len(wrong))
