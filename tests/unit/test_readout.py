"""Where a dish is, and how wrong that may be: on echoes whose errors are made up, so known."""

import numpy as np
import pytest

from ertis_detector.features import COHERENCE, NUM_FEATURES
from ertis_detector.readout import RING_OFFSET, SPHERE_RADIUS, fit_readout, ring_to_vertex_m

SIZES = ("r35", "r48", "r58", "r70")
BIAS_M = {"r35": 0.001, "r48": -0.002, "r58": -0.004, "r70": -0.006}


NULL = 0.075  # of the ring's beam, R / range


def world(seed, count=3000, azimuth_sigma=0.005, null_sigma=0.0):
    """Features that tell tilt and offset, but for noise; errors as the law has them."""
    rng = np.random.default_rng(seed)
    labels = rng.choice(SIZES, count)
    radius = np.array([int(label[1:]) / 1e3 for label in labels])
    tilt = rng.uniform(0, 0.6, count)
    vertex_m = rng.uniform(0.7, 5.0, count)
    snr_db = rng.uniform(12, 45, count)
    features = rng.normal(size=(count, NUM_FEATURES))
    features[:, COHERENCE] = rng.uniform(0.5, 1.0, (count, 1))
    features[:, 0] = tilt + rng.normal(0, 0.05, count)
    features[:, 1] *= 2e3
    bias = np.array([BIAS_M[label] for label in labels]) + 0.01 * features[:, 0]
    range_m = vertex_m + RING_OFFSET * radius - bias + rng.normal(0, 2e-3, count)
    aside = SPHERE_RADIUS * radius * np.sin(tilt) / (vertex_m - SPHERE_RADIUS * radius)
    azimuth = rng.normal(0, 1, count) * np.sqrt(azimuth_sigma**2 + 0.5 * aside**2)
    elevation = rng.normal(0, 1, count) * np.sqrt(0.004**2 + 0.09 * 10 ** (-snr_db / 10))
    is_null = np.abs(SPHERE_RADIUS * radius / range_m - NULL) < 0.005
    elevation += is_null * rng.choice([-1, 1], count) * null_sigma
    place = np.stack([range_m, azimuth, elevation], axis=1)
    truth = np.stack([vertex_m, 0 * azimuth, 0 * elevation, tilt], axis=1)
    return features.astype(np.float32), labels.tolist(), place, truth, snr_db


@pytest.fixture(scope="module")
def readout():
    return fit_readout(*world(1))


def test_the_bias_of_each_size_is_taken_out(readout):
    features, labels, place, truth, snr_db = world(2)
    vertex_m, _, _ = readout(features, labels, place[:, 0], snr_db)
    error_m = vertex_m - truth[:, 0]
    raw_m = ring_to_vertex_m(labels, place[:, 0]) - truth[:, 0]
    assert error_m.std() < 0.0025
    assert raw_m.std() > 0.003
    for size in SIZES:
        assert abs(error_m[np.array(labels) == size].mean()) < 6e-4


def test_tilt_is_read_as_far_as_the_features_tell_it(readout):
    features, labels, place, truth, snr_db = world(3)
    _, tilt, _ = readout(features, labels, place[:, 0], snr_db)
    assert np.sqrt(np.mean((tilt - truth[:, 3]) ** 2)) < 0.06
    assert tilt.min() >= 0


def test_the_errors_are_as_large_as_the_covariance_says(readout):
    features, labels, place, truth, snr_db = world(4)
    vertex_m, _, variances = readout(features, labels, place[:, 0], snr_db)
    errors = np.stack([vertex_m, place[:, 1], place[:, 2]], axis=1) - truth[:, :3]
    nees = np.mean(errors**2 / variances, axis=0)
    np.testing.assert_allclose(nees, 1.0, atol=0.15)
    near = truth[:, 0] < 1.2
    for part in (near, ~near):  # the law holds near and far, not only on the whole
        assert np.mean(errors[part] ** 2 / variances[part]) == pytest.approx(1.0, abs=0.15)


def test_a_turned_dish_nearby_is_less_sure_of_its_bearing(readout):
    features = np.zeros((2, NUM_FEATURES), np.float32)
    features[:, COHERENCE] = 1.0
    features[1, 0] = 0.5
    _, _, variances = readout(features, ["r70", "r70"], np.full(2, 0.8), np.full(2, 30.0))
    assert variances[1, 1] > 5 * variances[0, 1]


def test_no_echo_is_better_than_a_millimetre(readout):
    features, labels, place, _, _ = world(5, 50)
    _, _, variances = readout(features, labels, place[:, 0], np.full(50, 90.0))
    assert variances[:, 0].min() >= 1e-6


def test_a_feature_never_met_before_moves_nothing_far(readout):
    wild = np.full((1, NUM_FEATURES), 1e9, np.float32)
    vertex_m, tilt, _ = readout(wild, ["r48"], np.array([2.0]), np.array([30.0]))
    assert vertex_m[0] == pytest.approx(2.0, abs=0.15)
    assert 0 <= tilt[0] <= np.deg2rad(60)


def test_where_the_rings_beam_has_its_null_elevation_is_less_sure():
    readout = fit_readout(*world(6, null_sigma=0.08))
    features = np.zeros((3, NUM_FEATURES), np.float32)
    features[:, COHERENCE] = 1.0
    range_m = SPHERE_RADIUS * 0.058 / np.array([0.05, NULL, 0.1])
    _, _, variances = readout(features, ["r58"] * 3, range_m, np.full(3, 35.0))
    before, null, after = np.sqrt(variances[:, 2])
    assert null > 0.04
    assert max(before, after) < 0.5 * null


def test_an_echo_that_others_cover_is_less_sure_of_its_bearing():
    features, labels, place, truth, snr_db = world(7)
    covered = features[:, COHERENCE].mean(axis=1) < 0.6
    place[covered, 1] += np.random.default_rng(8).normal(0, 0.03, covered.sum())
    readout = fit_readout(features, labels, place, truth, snr_db)
    _, _, variances = readout(features, labels, place[:, 0], snr_db)
    assert variances[covered, 1].mean() > 3 * variances[~covered, 1].mean()


def test_the_law_is_of_echoes_that_the_fit_has_not_met():
    few = world(9, 220)  # hardly more than there are features
    readout = fit_readout(*few)
    features, labels, place, truth, snr_db = world(10)
    vertex_m, _, variances = readout(features, labels, place[:, 0], snr_db)
    nees = np.mean((vertex_m - truth[:, 0]) ** 2 / variances[:, 0])
    assert nees == pytest.approx(1.0, abs=0.4)


def test_what_is_another_echo_makes_no_error_larger():
    clean = fit_readout(*world(11))
    features, labels, place, truth, snr_db = world(11)
    place[::100, 1] += 0.2
    variances = fit_readout(features, labels, place, truth, snr_db)(
        features, labels, place[:, 0], snr_db
    )[2]
    expected = clean(features, labels, place[:, 0], snr_db)[2]
    assert variances[:, 1].mean() == pytest.approx(expected[:, 1].mean(), rel=0.15)


def test_a_turned_dish_may_be_less_sure_of_its_range():
    features, labels, place, truth, snr_db = world(12)
    nearer_m = 0.058 * (1 - np.cos(truth[:, 3]))
    place[:, 0] += np.random.default_rng(13).normal(0, 1, len(labels)) * nearer_m
    readout = fit_readout(features, labels, place, truth, snr_db)
    _, tilt, variances = readout(features, labels, place[:, 0], snr_db)
    turned = tilt > 0.45
    assert variances[turned, 0].mean() > 4 * variances[tilt < 0.15, 0].mean()
