import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_detector.errors import EvaluationError
from ertis_detector.splits import leave_one_out, random_folds


@given(
    st.lists(st.sampled_from("abc"), min_size=12, max_size=60),
    st.integers(2, 12),
    st.integers(0, 9),
)
def test_each_ping_is_asked_once_and_never_by_who_learnt_it(labels, num_folds, seed):
    labels = [*labels, *"aabbcc"]
    folds = random_folds(labels, num_folds, np.random.default_rng(seed))
    asked = np.concatenate([fold.left_out for fold in folds])
    assert sorted(asked) == list(range(len(labels)))
    for fold in folds:
        assert not set(fold.kept) & set(fold.left_out)
        assert len(fold.kept) + len(fold.left_out) == len(labels)
        for name in "abc":
            whole = labels.count(name)
            here = sum(labels[i] == name for i in fold.left_out)
            assert whole // num_folds <= here <= -(-whole // num_folds)


def test_another_seed_deals_otherwise():
    labels = ["a", "b"] * 30
    one, same, other = (random_folds(labels, 5, np.random.default_rng(s)) for s in (1, 1, 2))
    assert all((a.left_out == b.left_out).all() for a, b in zip(one, same, strict=True))
    assert any((a.left_out != b.left_out).any() for a, b in zip(one, other, strict=True))


def test_a_group_left_out_is_heard_by_nobody_who_is_asked():
    groups = ["office", "garage", "office", "lab", "garage"]
    folds = leave_one_out(groups)
    assert [fold.name for fold in folds] == ["office", "garage", "lab"]
    assert [list(fold.left_out) for fold in folds] == [[0, 2], [1, 4], [3]]
    assert all(set(fold.kept) == set(range(5)) - set(fold.left_out) for fold in folds)


def test_too_little_to_split_says_what_is_missing():
    with pytest.raises(EvaluationError, match="label b stands on one ping only"):
        random_folds(["a", "a", "b"], 2, np.random.default_rng(1))
    with pytest.raises(EvaluationError, match="1 folds: expected two"):
        random_folds(["a", "a"], 1, np.random.default_rng(1))
    with pytest.raises(EvaluationError, match="all pings are of lab"):
        leave_one_out(["lab", "lab"])
