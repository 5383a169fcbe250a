import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ertis_simulator.occlusion import Blocker, clear_part

TOWARD = np.array([-1.0, 0.0, 0.0])
SONAR = np.array([0.0, 0.0, 1.0])
RIM = np.array([3.0, 0.0, 1.0])
coordinate = st.floats(-3.0, 3.0)
point = st.tuples(coordinate, coordinate, coordinate).map(np.array)


def box(x0, x1, y0, y1, z0, z1):
    return Blocker.prism(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), z0, z1)


@given(point, point)
def test_a_way_is_blocked_where_a_walk_along_it_meets_the_box(start, end):
    blocker = box(-1.0, 1.0, -0.5, 0.7, -0.8, 0.4)
    walk = start + np.linspace(0, 1, 4001)[:, None] * (end - start)
    depth = np.minimum(walk - [-1.0, -0.5, -0.8], [1.0, 0.7, 0.4] - walk).min(axis=1).max()
    if abs(depth) > 5e-3:  # a walk in steps cannot judge a mere touch
        assert blocker.hits(start, end[None])[0] == (depth > 0)


def test_a_cylinder_blocks_as_wide_as_it_is():
    pipe = Blocker.cylinder(1.0, 0.0, 0.1, 0.0, 2.0)
    ends = np.array([[2.0, 0.0, 1.0], [2.0, 0.18, 1.0], [2.0, 0.22, 1.0], [2.0, 0.0, 6.0]])
    assert pipe.hits(SONAR, ends).tolist() == [True, True, False, False]


def test_what_is_seen_of_a_dish_falls_as_a_box_moves_before_it():
    parts = [
        clear_part(SONAR, RIM, TOWARD, 0.07, [box(1.5, 1.6, -1.0, edge, 0.0, 2.0)])
        for edge in np.linspace(-0.06, 0.06, 13)
    ]
    assert parts[0] == 1.0
    assert parts[-1] == 0.0
    assert 0.3 < parts[6] < 0.7
    assert parts == sorted(parts, reverse=True)


def test_what_stands_behind_or_below_hides_nothing():
    behind, low = box(3.2, 3.4, -1, 1, 0, 2), box(1, 2, -1, 1, 0, 0.8)
    assert clear_part(SONAR, RIM, TOWARD, 0.07, [behind, low]) == 1.0


def test_a_bush_lets_something_through():
    bush = Blocker.cylinder(1.5, 0.0, 0.5, 0.0, 2.0, opacity=0.6)
    assert np.isclose(clear_part(SONAR, RIM, TOWARD, 0.07, [bush]), 0.4)
    assert np.isclose(clear_part(SONAR, RIM, TOWARD, 0.07, [bush, bush]), 0.16)
