"""Slope and offset that make told probabilities come true."""

import numpy as np
import pytest
from scipy.special import log_softmax

from ertis_detector.detection import landmark_mask
from ertis_detector.model import load_model, shipped_model
from ertis_detector.recalibration import LEAST_UNKNOWN, Recalibration, fit_recalibration
from ertis_driver.chirp import DEFAULT_CHIRP

CLASSES = ("none", "r35", "r48", "unknown")
LANDMARK = landmark_mask(CLASSES)
BINARY = ("none", "landmark")


def told_and_true(law, count=40_000, seed=1):
    """Logarithms as told, and truths drawn as the law says."""
    rng = np.random.default_rng(seed)
    logarithms = log_softmax(rng.normal(0, 2.0, (count, len(CLASSES))), axis=1)
    p = law.applied(logarithms, CLASSES)
    truth = (p.cumsum(axis=1) < rng.random(count)[:, None]).sum(axis=1)
    return logarithms, np.minimum(truth, len(CLASSES) - 1)


def test_landmarks_are_all_but_none_and_unknown():
    assert LANDMARK.tolist() == [False, True, True, False]


@pytest.mark.parametrize("law", [Recalibration(1.5, -0.7, 0.0), Recalibration(0.6, 0.4, -1.5)])
def test_the_law_that_made_truths_is_found_again(law):
    found = fit_recalibration(*told_and_true(law), CLASSES)
    assert found.slope == pytest.approx(law.slope, rel=0.04)
    assert found.offset == pytest.approx(law.offset, abs=0.06)
    assert found.unknown_offset == pytest.approx(law.unknown_offset, abs=0.06)


def test_a_few_bowls_do_not_say_how_often_bowls_are_met():
    logarithms, truth = told_and_true(Recalibration(1.0, 0.0, -3.0), 4000)
    unknown = np.flatnonzero(truth == CLASSES.index("unknown"))
    assert unknown.size >= LEAST_UNKNOWN
    kept = np.delete(np.arange(truth.size), unknown[LEAST_UNKNOWN - 1 :])
    assert fit_recalibration(logarithms, truth, CLASSES).unknown_offset < -2.0
    assert fit_recalibration(logarithms[kept], truth[kept], CLASSES).unknown_offset == 0.0


@pytest.mark.parametrize("over", [3.0, 5.0, 10.0])
def test_a_law_far_from_what_is_told_is_found_too(over):
    rng = np.random.default_rng(0)
    odds = rng.normal(0, 8.0, 20_000)  # told; true are less
    truth = (rng.random(odds.size) < 1 / (1 + np.exp(-odds / over))).astype(int)
    logarithms = log_softmax(np.stack([np.zeros_like(odds), odds], axis=1), axis=1)
    found = fit_recalibration(logarithms, truth, BINARY)
    assert found.slope == pytest.approx(1 / over, rel=0.05)
    assert found.offset == pytest.approx(0.0, abs=0.1)


def test_one_wrong_among_thousands_that_are_sure_does_not_throw_the_law():
    logarithms = np.log(np.tile([1e-6, 1 - 1e-6], (2000, 1)))
    truth = np.ones(2000, int)
    truth[0] = 0
    law = fit_recalibration(logarithms, truth, BINARY)
    told = law.applied(logarithms[:1], BINARY)[0, 1]
    assert told == pytest.approx(1999 / 2000, abs=3e-4)


def test_without_echoes_all_is_left_as_it_is():
    empty = np.zeros((0, len(CLASSES)))
    assert fit_recalibration(empty, np.zeros(0, np.intp), CLASSES) == Recalibration(1.0, 0.0)


def test_weights_say_how_often_each_is_met():
    logarithms, truth = told_and_true(Recalibration())
    weights = np.where(LANDMARK[truth], 1.0, np.exp(1.0))
    found = fit_recalibration(logarithms, truth, CLASSES, weights)
    assert found.offset == pytest.approx(-1.0, abs=0.06)
    assert found.slope == pytest.approx(1.0, rel=0.04)


def test_a_classifier_tells_what_the_law_makes_of_it():
    classifier = load_model(shipped_model(DEFAULT_CHIRP.name)).classifier
    features = np.random.default_rng(2).normal(0, 1, (40, 138)).astype(np.float32)
    law = Recalibration(1.3, -0.5, 0.8)
    before = classifier.probabilities(features).astype(np.float64)
    after = law.of(classifier).probabilities(features)
    expected = law.applied(np.log(before), classifier.classes)
    np.testing.assert_allclose(after, expected, atol=2e-5)


def test_a_threshold_moves_as_probabilities_do():
    law = Recalibration(1.5, -0.7)
    logarithms = np.log([[0.16, 0.84]])
    moved = law.applied(logarithms, BINARY)[0, 1]
    assert law.threshold(0.84) == pytest.approx(moved)
