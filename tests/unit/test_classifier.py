import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingClassifier

from ertis_detector.classifier import both_votes, couple
from ertis_detector.fit_trees import fit_trees
from ertis_detector.fitting import Echoes, fit
from ertis_detector.networks import Committee, softmax
from ertis_detector.trees import Trees

CLASSES = ("none", "r35", "r48", "r58")


def clouds(seed, count=240, spread=1.0, num_features=20):
    """Labelled points about one centre a class, and a group for every four of them."""
    rng = np.random.default_rng(seed)
    centres = np.random.default_rng(99).normal(0, 1.0, (len(CLASSES), num_features))
    index = rng.integers(0, len(CLASSES), count)
    features = centres[index] + rng.normal(0, spread, (count, num_features))
    groups = [f"scene {i // 4}" for i in range(count)]
    return features.astype(np.float32), [CLASSES[i] for i in index], groups


def fitted_to(features, labels, groups, weights=None, **options):
    echoes = Echoes(features, list(labels), list(groups), weights)
    return fit(echoes, num_networks=1, num_folds=3, **options)


def unseen(features, labels, groups):
    """What is said of each row by classifiers that saw none of its group."""
    made = fitted_to(features, labels, groups)
    np.testing.assert_allclose(made.probabilities.sum(axis=1), 1.0, atol=1e-5)
    return np.array(made.classifier.classes)[made.probabilities.argmax(axis=1)]


@pytest.fixture(scope="module")
def fitted():
    return fitted_to(*clouds(1, 400)).classifier


def test_numpy_applies_trees_as_scikit_learn_does():
    features, labels, _ = clouds(1, 400)
    fresh, _, _ = clouds(2, 300)
    trees = fit_trees(features, np.array(labels), num_rounds=20)
    theirs = HistGradientBoostingClassifier(
        max_iter=20,
        learning_rate=0.09,
        max_leaf_nodes=32,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=0,
    ).fit(features, labels)
    np.testing.assert_allclose(trees.votes(fresh), theirs.predict_proba(fresh), atol=1e-5)


def test_two_classes_are_trees_too():
    features, labels, _ = clouds(3, 300)
    pair = np.isin(labels, ("none", "r35"))
    trees = fit_trees(features[pair], np.array(labels)[pair], num_rounds=10)
    votes = trees.votes(features[pair])
    assert votes.shape == (pair.sum(), 2)
    assert np.mean((votes[:, 1] > 0.5) == (np.array(labels)[pair] == "r35")) > 0.95


def test_a_tree_leads_to_the_leaf_that_its_answers_leave():
    """One tree by hand: feature 1 at most 0.5, then feature 0 at most -1; and one of a leaf."""
    leaves = np.zeros((2, 32), np.float32)
    leaves[0, :3], leaves[1, 0] = (7.0, 8.0, 9.0), 2.0
    trees = Trees(
        np.array([1, 0, 0], np.uint8),
        np.array([0.5, -1.0, 0.0], np.float32),
        np.array([0xFFFFFFFE, 0xFFFFFFFD, 0xFFFFFFFF], np.uint32),
        np.array([0, 2], np.int32),
        leaves,
        np.array([0.25, 0.5], np.float32),
    )
    rows = np.array([[0, 0.5], [0, 0.6], [-1, 0.6], [-2, 0.4]], np.float32)
    expected = [[7.25, 2.5], [9.25, 2.5], [8.25, 2.5], [7.25, 2.5]]
    np.testing.assert_allclose(trees.scores(rows), expected)


def test_a_committee_is_the_mean_of_its_networks_probabilities():
    rng = np.random.default_rng(4)
    shapes = [(3, 5, 4), (3, 1, 4), (3, 4, 3), (3, 1, 3), (3, 3, 2), (3, 1, 2)]
    layers = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    committee = Committee(np.zeros(5, np.float32), np.ones(5, np.float32), *layers)
    rows = rng.normal(size=(6, 5)).astype(np.float32)
    expected = np.zeros((6, 2))
    for k in range(3):
        hidden = rows
        for weights, bias in zip(layers[0:4:2], layers[1:4:2], strict=True):
            hidden = np.maximum(hidden @ weights[k] + bias[k], 0)
        expected += softmax(hidden @ layers[4][k] + layers[5][k]) / 3
    np.testing.assert_allclose(committee.votes(rows), expected, rtol=1e-5)


def test_the_law_hears_networks_and_trees_apart(fitted):
    fresh, _, _ = clouds(4, 50)
    both = both_votes(fitted.committee, fitted.trees, fresh)
    np.testing.assert_array_equal(both[:, :4], fitted.committee.votes(fresh))
    np.testing.assert_array_equal(both[:, 4:], fitted.trees.votes(fresh))
    silent = both.copy()
    silent[:, 4:] = 0.25  # trees that know nothing
    law = fitted.coupling, fitted.offset
    assert np.abs(couple(silent, *law) - couple(both, *law)).max() > 0.05


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


def test_what_is_said_of_a_row_does_not_depend_on_its_neighbours(fitted):
    fresh, _, _ = clouds(6, 20)
    together = fitted.probabilities(fresh)
    for row, found in zip(fresh, together, strict=True):
        np.testing.assert_allclose(fitted.probabilities(row[None])[0], found, atol=1e-5)


def test_probabilities_are_calibrated_on_unseen_groups():
    classifier = fitted_to(*clouds(6, 1200, spread=2.2)).classifier
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
    features, labels, groups = clouds(9, 400, spread=0.3)
    predicted = unseen(features, np.array(labels), groups)
    assert np.mean(predicted == np.array(labels)) > 0.98


def test_the_number_of_workers_changes_nothing():
    features, labels, groups = clouds(10, 200)
    one, two = (fitted_to(features, labels, groups, workers=n) for n in (1, 2))
    np.testing.assert_array_equal(one.probabilities, two.probabilities)


def test_a_feature_that_never_changes_does_no_harm():
    features, labels, groups = clouds(12)
    features[:, 3] = 7.0
    classifier = fitted_to(features, labels, groups).classifier
    assert np.isfinite(classifier.probabilities(features)).all()


def test_one_class_alone_is_refused():
    features, _, groups = clouds(13)
    with pytest.raises(ValueError, match="nothing to tell apart"):
        fitted_to(features, ["none"] * len(features), groups)


def test_a_class_of_a_single_scene_is_refused():
    features, labels, groups = clouds(14)
    pairs = zip(labels, groups, strict=True)
    labels = ["r70" if group == "scene 0" else label for label, group in pairs]
    with pytest.raises(ValueError, match="too few groups"):
        fitted_to(features, labels, groups)


def test_what_does_not_teach_is_not_learnt_but_its_probabilities_are_told():
    features, labels, groups = clouds(10, 600)
    told = np.array(labels)
    teaches = told != "r58"
    made = fitted_to(features, labels, groups, teaches=teaches)
    assert made.classifier.classes == ("none", "r35", "r48")
    assert made.probabilities.shape == (600, 3)
    np.testing.assert_allclose(made.probabilities[~teaches].sum(axis=1), 1.0, atol=1e-5)


def test_probabilities_come_true_where_landmarks_are_as_rare_as_the_weights_say():
    """A quarter of the rows is clutter; where robots live, eight in nine are."""
    features, labels, groups = clouds(11, 1500, spread=2.5)
    is_clutter = np.array(labels) == "none"
    weights = np.where(is_clutter, 24.0, 1.0)
    made = fitted_to(features, labels, groups, weights)
    fresh, truth, _ = clouds(12, 6000, spread=2.5)
    there = np.where(np.array(truth) == "none", 24.0, 1.0)
    said = made.classifier.probabilities(fresh)[:, 1:].sum(axis=1)
    assert np.average(said, weights=there) == pytest.approx(3 / 27, abs=0.03)
    unweighted = fitted_to(features, labels, groups)
    assert unweighted.classifier.probabilities(fresh)[:, 1:].sum(axis=1).mean() > 0.6


def test_fresh_echoes_calibrate_and_are_judged_but_teach_nothing():
    """Networks and trees are those of all taught rows; the law is fitted to the fresh ones."""
    features, labels, groups = clouds(15, 400, spread=2.2)
    fresh = Echoes(*clouds(16, 600, spread=2.2))
    alone = fitted_to(features, labels, groups)
    made = fitted_to(features, labels, groups, fresh=fresh)
    unseen, truth, _ = clouds(17, 4000, spread=2.2)
    np.testing.assert_array_equal(made.classifier.votes(unseen), alone.classifier.votes(unseen))
    assert made.probabilities.shape == (600, 4)
    rows = made.classifier.probabilities(unseen)
    right = np.array(made.classifier.predict(unseen)) == truth
    assert rows.max(axis=1).mean() == pytest.approx(right.mean(), abs=0.03)
    judged = made.probabilities[np.arange(600), [CLASSES.index(one) for one in fresh.labels]]
    own = made.classifier.probabilities(fresh.features)
    own = own[np.arange(600), [CLASSES.index(one) for one in fresh.labels]]
    assert np.log(judged).mean() < np.log(own).mean()  # by laws that have not met them


def test_fresh_echoes_without_one_of_the_classes_are_refused():
    features, labels, groups = clouds(18, 400, spread=0.3)
    kept = np.array(labels) != "r58"
    few = Echoes(*(np.array(one)[kept] for one in (features, labels, groups)))
    with pytest.raises(ValueError, match="too few groups"):
        fitted_to(features, labels, groups, fresh=few)
