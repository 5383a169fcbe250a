import numpy as np
import pytest

from ertis_simulator.clutter import CLUSTER_KINDS, Clutter, cluster

ROOM = (0.0, 10.0), (0.0, 8.0)


def test_the_density_counts_things_not_points():
    only = {"pipe": 1.0}
    num_points = [
        len(Clutter.scatter(*ROOM, 2.0, np.random.default_rng(seed), weights=only).points.lengths_m)
        for seed in range(20)
    ]
    # 160 things of 1 to 3 points each.
    assert np.mean(num_points) == pytest.approx(160 * 2, rel=0.05)


def test_clutter_stands_in_its_room_and_below_its_top():
    points = Clutter.scatter(*ROOM, 3.0, np.random.default_rng(1), top_m=1.2).points.positions_m
    inside = (points > [0, 0, 0]) & (points < [10, 8, 1.2])
    assert inside.mean() > 0.9  # a thing at the edge reaches a little beyond


@pytest.mark.parametrize("name", CLUSTER_KINDS)
def test_each_kind_has_its_own_count_level_and_spectrum(name):
    kind = CLUSTER_KINDS[name]
    rng = np.random.default_rng(2)
    made = [cluster(kind, np.zeros(3), rng) for _ in range(400)]
    counts = [len(one.lengths_m) for one in made]
    assert (min(counts), max(counts)) == kind.num_glints
    assert {float(e) for one in made for e in one.exponents} == set(kind.exponents)
    assert all(len(set(one.exponents)) == 1 for one in made)
    fronts = [20 * np.log10(np.abs(one.lengths_m[0])) for one in made]
    assert np.mean(fronts) == pytest.approx(kind.level_db, abs=1.0)
    assert np.std(fronts) == pytest.approx(5.0, abs=0.6)
    assert -36.0 <= kind.level_db <= -31.0  # the span that acoustics gives


def test_what_is_behind_in_a_concave_thing_is_stronger():
    rng = np.random.default_rng(3)
    made = [cluster(CLUSTER_KINDS["concave"], np.zeros(3), rng) for _ in range(300)]
    gain = [np.mean(np.abs(one.lengths_m[1:])) / np.abs(one.lengths_m[0]) for one in made]
    assert np.median(gain) == pytest.approx(2.0, rel=0.2)
    reach = [np.linalg.norm(one.positions_m[1:] - one.positions_m[0], axis=1) for one in made]
    assert 0.02 < np.median(np.concatenate(reach)) < 0.06


def test_only_the_kinds_asked_for_are_strewn():
    clutter = Clutter.scatter(*ROOM, 2.0, np.random.default_rng(4), weights={"edge": 1.0})
    assert set(clutter.points.exponents) == {-0.5}


def test_clutter_moved_is_the_same_clutter():
    clutter = Clutter.scatter(*ROOM, 1.0, np.random.default_rng(5))
    moved = clutter.shifted(np.array([1.0, 2.0, 0.0]))
    shift = moved.points.positions_m - clutter.points.positions_m
    assert np.allclose(shift, [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(moved.points.lengths_m, clutter.points.lengths_m)
