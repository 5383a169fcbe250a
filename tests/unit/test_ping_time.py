import time

import numpy as np
import pytest

from ertis_driver.clock import HostClock, read_clocks
from ertis_driver.frame_reader import Arrival
from ertis_driver.protocol import RawFrame
from ertis_driver.trigger_time import SEND_LATENCY_S, USB_LATENCY_S, commanded, heard_of

LISTENING_S = 0.0364
RAW = RawFrame(0, np.zeros(1, np.uint32))


def test_a_command_takes_effect_after_it_was_written():
    assert commanded(10.0, 10.2) == (10.0, 10.2 + USB_LATENCY_S)


@pytest.mark.parametrize("delay_s", [0.0, LISTENING_S, LISTENING_S + SEND_LATENCY_S])
def test_an_edge_lies_in_its_interval_whether_sent_while_listening_or_after(delay_s):
    edge_s = 100.0
    first_s = edge_s + delay_s
    last_s = max(first_s + 0.02, edge_s + LISTENING_S)
    earliest, latest = heard_of(Arrival(RAW, (first_s, first_s), last_s), LISTENING_S)
    assert earliest <= edge_s <= latest
    assert latest - earliest <= LISTENING_S + SEND_LATENCY_S


def test_the_interval_of_a_replay_faster_than_sound_is_not_inside_out():
    earliest, latest = heard_of(Arrival(RAW, (5.0, 5.0), 5.001), LISTENING_S)
    assert earliest <= latest


def test_unix_time_of_a_past_instant():
    clock = HostClock()
    now_s, now_ns = time.monotonic(), time.time_ns()
    assert abs(clock.unix_ns(now_s - 2.0)[0] - (now_ns - 2_000_000_000)) < 50_000_000
    assert clock.take_step_ns() == 0


@pytest.mark.parametrize(("before_s", "after_s"), [(2e-3, 0.0), (0.0, 2e-3), (1.2e-4, 0.0)])
def test_a_thread_scheduled_away_between_two_clocks_says_how_far_it_may_be_off(before_s, after_s):
    def read():
        time.sleep(before_s)
        told = read_clocks()
        time.sleep(after_s)
        return told

    earliest_ns = time.time_ns()
    instant_s = time.monotonic()
    latest_ns = time.time_ns()
    time_ns, error_ns = HostClock(read).unix_ns(instant_s)
    slewed_ns = 20_000  # UNIX time may be slewed by 500 ppm against the monotonic clock
    assert time_ns - error_ns <= latest_ns + slewed_ns
    assert time_ns + error_ns >= earliest_ns - slewed_ns
    assert max(before_s, after_s) / 2 <= error_ns * 1e-9


def test_the_promptest_of_some_readings_is_taken():
    pauses_s = iter([5e-3, 1e-2, 0.0, *[5e-3] * 20])

    def read():
        time.sleep(next(pauses_s))
        return read_clocks()

    _, error_ns = HostClock(read).unix_ns(time.monotonic())
    assert error_ns < 2_500_000


def test_both_clocks_are_read_at_one_instant():
    unix_ns, boot_ns = read_clocks()
    later_unix_ns, later_boot_ns = read_clocks()
    assert abs((later_unix_ns - unix_ns) - (later_boot_ns - boot_ns)) < 50_000_000


def test_steps_add_up_until_they_are_told_once():
    readings = iter([(1_000, 0), (9_000_000, 1), (9_000_002, 2), (4_000_000, 3), (4_000_500, 4)])
    clock = HostClock(lambda: next(readings))
    steps = []
    for _ in range(4):
        clock.unix_ns(time.monotonic())
    steps.append(clock.take_step_ns())
    clock.unix_ns(time.monotonic())
    steps.append(clock.take_step_ns())
    assert steps == [3_998_997, 0]
