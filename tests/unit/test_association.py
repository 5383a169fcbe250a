import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment

from ertis_detector.association import assign

shapes = st.tuples(st.integers(0, 7), st.integers(0, 7))
scores = st.one_of(st.floats(-20.0, 20.0), st.integers(-3, 3).map(float), st.just(-np.inf))


@given(shapes.flatmap(lambda shape: arrays(float, shape, elements=scores)))
def test_no_assignment_is_worth_more(table):
    pairs = assign(table)
    paying = np.maximum(table, 0.0)
    rows, columns = linear_sum_assignment(-paying)
    assert sum(table[pair] for pair in pairs) == pytest.approx(paying[rows, columns].sum())
    assert all(table[pair] > 0 for pair in pairs)
    assert len({row for row, _ in pairs}) == len({column for _, column in pairs}) == len(pairs)


def test_the_best_of_all_goes_before_the_best_of_one():
    assert sorted(assign(np.array([[10.0, 9.0], [9.0, 1.0]]))) == [(0, 1), (1, 0)]
