import numpy as np
import pytest

from ertis_detector.intervals import cluster_bootstrap, garwood, wilson


def test_wilsons_interval_is_the_printed_one():
    # Newcombe 1998, table I: 81 of 263 and 1 of 29, method 3.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)


def test_a_share_of_none_or_all_stays_inside_zero_and_one():
    assert wilson(0, 20)[0] == 0.0
    assert wilson(20, 20)[1] == 1.0
    assert np.isnan(wilson(0, 0)).all()


def test_garwoods_interval_is_the_printed_one():
    # Exact Poisson limits of 0 and 10 events, as in any table of them.
    assert garwood(0, 1.0) == pytest.approx((0.0, 3.6889), abs=5e-5)
    assert garwood(10, 2.0) == pytest.approx((4.7954 / 2, 18.3904 / 2), abs=5e-5)
    assert np.isnan(garwood(3, 0.0)).all()


def test_clusters_that_agree_with_themselves_widen_the_interval():
    rng = np.random.default_rng(1)
    values = np.repeat(rng.random(20) < 0.5, 50).astype(float)
    alone = cluster_bootstrap(values, [str(i) for i in range(values.size)])
    together = cluster_bootstrap(values, [str(i // 50) for i in range(values.size)])
    assert together[1] - together[0] > 4 * (alone[1] - alone[0])


def test_the_bootstrap_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(2)
    names = [str(i // 5) for i in range(200)]
    covered = 0
    for _ in range(60):
        room = rng.normal(0, 1, 40)
        low, high = cluster_bootstrap(np.repeat(room, 5) + rng.normal(0, 1, 200), names)
        covered += low <= 0 <= high
    assert 51 <= covered <= 60  # 57 expected


def test_what_is_not_known_is_left_out_and_one_cluster_says_nothing():
    values = [1.0, 1.0, float("nan"), 0.0, 0.0]
    low, high = cluster_bootstrap(values, ["a", "a", "c", "b", "b"])
    assert (low, high) == (0.0, 1.0)
    assert np.isnan(cluster_bootstrap(values[:3], ["a", "a", "c"])).all()
