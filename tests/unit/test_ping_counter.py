import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver.ping_counter import GAP_ALLOWANCE, PingCounter, missing_between


@given(st.integers(0, 2**32 - 1), st.integers(0, GAP_ALLOWANCE))
def test_a_gap_is_counted_exactly_also_over_the_wrap(first, gap):
    counter = PingCounter(1.0, now_s=lambda: 0.0)
    assert counter.take(first) == "next"
    assert counter.take((first + 1 + gap) % 2**32) == "next"
    assert (counter.pings_lost, counter.restarts) == (gap, 0)


@given(st.integers(0, 2**32 - 1), st.integers(GAP_ALLOWANCE + 2, 2**32 - 1))
def test_an_index_that_falls_or_leaps_is_a_restart(first, step):
    counter = PingCounter(1.0, now_s=lambda: 0.0)
    counter.take(first)
    second = (first + step) % 2**32
    assert not counter.plausible(second)
    assert counter.take(second) == "restart"
    assert counter.take((second + 1) % 2**32) == "next"
    assert (counter.pings_lost, counter.restarts) == (0, 1)


def test_a_long_silence_makes_room_for_a_large_gap():
    now_s = [0.0]
    counter = PingCounter(0.0364, now_s=lambda: now_s[0])
    counter.take(0)
    now_s[0] = 86_400.0
    assert counter.take(864_000) == "next", "a day at 10 Hz"
    assert counter.pings_lost == 863_999
    assert counter.take(2 * 864_000) == "restart", "at once"


def test_the_same_ping_again_is_no_loss():
    counter = PingCounter(1.0)
    counter.take(7)
    assert counter.take(7) == "again"
    assert counter.pings_lost == counter.restarts == 0


@pytest.mark.parametrize("index", [0, 5, 2**32 - 1])
def test_after_forgetting_any_index_may_come(index):
    counter = PingCounter(1.0)
    counter.take(5)
    counter.forget()
    assert counter.take(index) == "next"
    assert counter.pings_lost == 0


@pytest.mark.parametrize(
    ("last", "index", "missing"),
    [(0, 1, 0), (5, 9, 3), (2**32 - 2, 1, 2), (7, 7, 0), (7, 3, 0), (0, 2**31, 0)],
)
def test_what_is_missing_between_two_pings(last, index, missing):
    assert missing_between(last, index) == missing
