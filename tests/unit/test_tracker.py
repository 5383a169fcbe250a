import numpy as np
import pytest

from ertis_detector.detection import Detection
from ertis_detector.tracker import GATE_M, MAX_SILENCE_NS, Tracker

PERIOD_NS = 150_000_000
NO_COVARIANCE = ((0.0,) * 3,) * 3


def seen(range_m=1.5, azimuth_deg=0.0, label="r48"):
    azimuth_rad = float(np.deg2rad(azimuth_deg))
    return Detection(label, {label: 1.0}, range_m, azimuth_rad, 0.0, NO_COVARIANCE, 20.0)


def states(tracks):
    return [(track.track_id, track.state) for track in tracks]


def test_a_landmark_keeps_its_number_while_it_is_followed():
    tracker = Tracker()
    assert states(tracker.update([seen()], 0)) == [(1, "new")]
    for ping in range(1, 20):
        heard = seen(1.5 - 0.05 * ping, 2.0 * ping)
        (track,) = tracker.update([heard], ping * PERIOD_NS)
        assert (track.track_id, track.state) == (1, "update")
        assert track.detection is heard


def test_a_short_silence_is_forgiven():
    tracker = Tracker()
    tracker.update([seen()], 0)
    assert tracker.update([], MAX_SILENCE_NS) == []
    assert states(tracker.update([seen()], MAX_SILENCE_NS + 1)) == [(1, "update")]


def test_after_long_silence_it_is_lost_once_and_a_new_one_gets_a_new_number():
    tracker = Tracker()
    heard = seen()
    tracker.update([heard], 0)
    (lost,) = tracker.update([], MAX_SILENCE_NS + 1)
    assert (lost.track_id, lost.state) == (1, "lost")
    assert lost.detection is heard
    assert tracker.update([], MAX_SILENCE_NS + 2) == []
    assert states(tracker.update([seen()], MAX_SILENCE_NS + 3)) == [(2, "new")]


def test_silence_counts_from_when_it_was_last_heard():
    tracker = Tracker()
    tracker.update([seen()], 0)
    tracker.update([seen()], MAX_SILENCE_NS)
    assert tracker.update([], 2 * MAX_SILENCE_NS) == []
    assert states(tracker.update([], 2 * MAX_SILENCE_NS + 1)) == [(1, "lost")]


def test_two_of_the_same_size_apart_keep_two_numbers():
    tracker = Tracker()
    left, right = seen(1.5, 15.0), seen(1.5, -15.0)
    assert states(tracker.update([left, right], 0)) == [(1, "new"), (2, "new")]
    for ping in range(1, 10):
        left, right = seen(1.5, 15.0 - ping), seen(1.5, -15.0 - ping)
        order = [right, left] if ping % 2 else [left, right]
        tracks = tracker.update(order, ping * PERIOD_NS)
        assert {t.track_id: t.detection for t in tracks} == {1: left, 2: right}


def test_the_nearer_of_two_is_continued():
    tracker = Tracker()
    tracker.update([seen(1.00), seen(1.25)], 0)
    assert states(tracker.update([seen(1.20)], PERIOD_NS)) == [(2, "update")]


def test_one_number_is_given_once_a_ping():
    tracker = Tracker()
    tracker.update([seen(1.5)], 0)
    tracks = tracker.update([seen(1.5), seen(1.55)], PERIOD_NS)
    assert states(tracks) == [(1, "update"), (2, "new")]


def test_another_size_at_the_same_place_is_another_landmark():
    tracker = Tracker()
    tracker.update([seen(label="r48")], 0)
    assert states(tracker.update([seen(label="r58")], PERIOD_NS)) == [(2, "new")]


@pytest.mark.parametrize(("step_m", "state"), [(0.99 * GATE_M, "update"), (1.01 * GATE_M, "new")])
def test_the_gate_is_as_wide_as_it_says(step_m, state):
    tracker = Tracker()
    tracker.update([seen(2.0)], 0)
    assert tracker.update([seen(2.0 + step_m)], PERIOD_NS)[0].state == state


def test_nearness_is_a_matter_of_place_not_of_range_alone():
    tracker = Tracker()
    tracker.update([seen(2.0, 20.0)], 0)
    assert tracker.update([seen(2.0, -20.0)], PERIOD_NS)[0].state == "new"


def test_numbers_are_not_shared_between_trackers_and_never_used_twice():
    tracker, given = Tracker(), []
    for ping in range(5):
        tracks = tracker.update([seen()], ping * 2 * (MAX_SILENCE_NS + 1) + 1)
        given += [t.track_id for t in tracks if t.state == "new"]
        tracker.update([], (2 * ping + 1) * (MAX_SILENCE_NS + 1) + 1)
    assert len(given) == len(set(given)) >= 1
    assert states(Tracker().update([seen()], 0)) == [(1, "new")]
