from itertools import combinations

import numpy as np
import pytest
from sklearn.svm import SVC, LinearSVC

from ertis_detector.classifier import OneVersusOne, fit, softmax

CLASSES = ("none", "r35", "r48", "r58")


def clouds(seed, count=240, spread=1.0, num_features=20):
    """Labelled points about one centre a class, and a group for every four of them."""
    rng = np.random.default_rng(seed)
    centres = np.random.default_rng(99).normal(0, 1.0, (len(CLASSES), num_features))
    index = rng.integers(0, len(CLASSES), count)
    features = centres[index] + rng.normal(0, spread, (count, num_features))
    groups = [f"scene {i // 4}" for i in range(count)]
    return features.astype(np.float32), [CLASSES[i] for i in index], groups


def unseen(features, labels, groups):
    """What is said of each row by classifiers that saw none of its group."""
    made = fit(features, labels.tolist(), list(groups))
    np.testing.assert_allclose(made.probabilities.sum(axis=1), 1.0, atol=1e-5)
    return np.array(made.classifier.classes)[made.probabilities.argmax(axis=1)]


@pytest.fixture(scope="module")
def fitted():
    return fit(*clouds(1)).classifier


def test_numpy_decides_each_pair_as_scikit_learn_does(fitted):
    features, labels, _ = clouds(1)
    fresh, _, _ = clouds(2, 500)
    margins = fitted.decision_margins(fresh)
    mean, scale = features.mean(axis=0), features.std(axis=0)
    told = np.array(labels)
    for column, (a, b) in enumerate(combinations(CLASSES, 2)):
        pair = (told == a) | (told == b)
        svm = LinearSVC(C=0.1, class_weight="balanced", dual=False)
        svm.fit((features[pair] - mean) / scale, told[pair] == a)
        theirs = svm.decision_function((fresh - mean) / scale)
        np.testing.assert_allclose(margins[:, column], theirs, atol=1e-3)
        says_a = svm.predict((fresh - mean) / scale)
        clear = np.abs(theirs) > 1e-3
        np.testing.assert_array_equal((margins[:, column] > 0)[clear], says_a[clear])


def test_the_predictions_are_mostly_those_of_scikit_learns_own_voting(fitted):
    features, labels, _ = clouds(1)
    fresh, _, _ = clouds(3, 500)
    mean, scale = features.mean(axis=0), features.std(axis=0)
    svm = SVC(kernel="linear", C=1.0).fit((features - mean) / scale, labels)
    agreed = np.mean(svm.predict((fresh - mean) / scale) == fitted.predict(fresh))
    assert agreed > 0.93


def test_it_recognises_what_it_has_not_seen(fitted):
    fresh, labels, _ = clouds(4, 400)
    assert np.mean(np.array(fitted.predict(fresh)) == labels) > 0.9


def test_probabilities_sum_to_one_and_the_largest_is_the_prediction(fitted):
    fresh, _, _ = clouds(5, 300)
    rows = fitted.probabilities(fresh)
    assert rows.shape == (300, 4)
    assert rows.min() >= 0
    np.testing.assert_allclose(rows.sum(axis=1), 1.0, atol=1e-5)
    best = np.array(fitted.classes)[rows.argmax(axis=1)]
    np.testing.assert_array_equal(best, fitted.predict(fresh))


def test_probabilities_are_calibrated_on_unseen_groups():
    classifier = fit(*clouds(6, 1200, spread=2.2)).classifier
    fresh, labels, _ = clouds(7, 4000, spread=2.2)
    rows = classifier.probabilities(fresh)
    said, right = rows.max(axis=1), np.array(classifier.predict(fresh)) == labels
    assert said.mean() == pytest.approx(right.mean(), abs=0.06)


def test_a_group_never_stands_on_both_sides_of_a_fold():
    """Rows that are random but identical within their group teach nothing about other groups."""
    rng = np.random.default_rng(8)
    rows = rng.normal(size=(60, 40)).astype(np.float32)
    labels = rng.permutation(np.repeat(("none", "r48"), 30))
    features, told = np.repeat(rows, 6, axis=0), np.repeat(labels, 6)
    groups = np.repeat([f"scene {i}" for i in range(60)], 6)
    order = rng.permutation(len(told))
    leaky = unseen(features[order], told[order], [str(i) for i in range(360)])
    honest = unseen(features[order], told[order], groups[order])
    assert np.mean(leaky == told[order]) > 0.9  # so the plant does leak, where it may
    assert 0.25 < np.mean(honest == told[order]) < 0.75


def test_the_cross_validated_predictions_stand_in_the_order_of_the_rows():
    features, labels, groups = clouds(9, spread=0.3)
    predicted = unseen(features, np.array(labels), groups)
    assert np.mean(predicted == np.array(labels)) > 0.98


def test_a_rare_class_is_not_forgotten():
    features, labels, groups = clouds(10, 400, spread=0.5)
    kept = [i for i, label in enumerate(labels) if label != "r58" or i % 8 == 0]
    classifier = fit(
        features[kept], [labels[i] for i in kept], [groups[i] for i in kept]
    ).classifier
    fresh, told, _ = clouds(11, 400, spread=0.5)
    rare = np.array(told) == "r58"
    assert np.mean(np.array(classifier.predict(fresh))[rare] == "r58") > 0.9


def test_a_feature_that_never_changes_does_no_harm():
    features, labels, groups = clouds(12)
    features[:, 3] = 7.0
    classifier = fit(features, labels, groups).classifier
    assert np.isfinite(classifier.probabilities(features)).all()


def test_training_names_what_is_missing():
    features, labels, groups = clouds(13, 40)
    with pytest.raises(ValueError, match="two classes at least, met r48"):
        fit(features, ["r48"] * 40, groups)
    with pytest.raises(ValueError, match="5 scenes at least, met 3"):
        fit(features, labels, [f"scene {i % 3}" for i in range(40)])
    with pytest.raises(ValueError, match="two classes at least, met none"):
        fit(features[:0], [], [])


def test_a_class_that_only_one_fold_holds_is_named_or_lived_with():
    features, labels, groups = clouds(14, 80)
    labels = [
        "r70" if group == "scene 3" else label for label, group in zip(labels, groups, strict=True)
    ]
    try:
        classifier = fit(features, labels, groups).classifier
    except ValueError as error:
        assert "r70" in str(error)  # noqa: PT017
    else:
        assert "r70" in classifier.classes


def test_margins_become_log_odds_by_the_coupling():
    one = np.ones(1, np.float32)
    weights, bias = np.array([[1.0], [0.0], [0.0]], np.float32), np.zeros(3, np.float32)
    coupling = np.array([[1, -1, 0], [1, 0, -1], [0, 1, -1]], np.float32)
    offset = np.array([0.0, 0.0, -2.0], np.float32)
    classifier = OneVersusOne(("a", "b", "c"), 0 * one, one, weights, bias, coupling, offset)
    rows = classifier.probabilities(np.array([[0.5], [-0.5], [50.0], [60.0]], np.float32))
    odds = np.log(rows[:, :1] / rows)
    np.testing.assert_allclose(odds[:2], [[0, 1, 2.5], [0, -1, 1.5]], atol=1e-5)
    np.testing.assert_allclose(odds[2], odds[3], atol=1e-5)  # a margin counts up to a cap
    assert classifier.predict(np.array([[5.0], [-0.5]], np.float32)) == ["a", "b"]


def test_softmax_survives_large_values():
    np.testing.assert_allclose(softmax(np.array([[1e4, 0.0]], np.float32)), [[1.0, 0.0]])
