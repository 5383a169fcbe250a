import dataclasses
import math

import numpy as np
import pytest

from ertis_detector.detection import Detection
from ertis_detector.motion import Motion, PlanarPose
from ertis_detector.rates import DetectorRates
from ertis_detector.tracker import MAX_FOLLOWED, MAX_TAKEN, Tracker, TrackerSettings

PERIOD_NS = 150_000_000
COVARIANCE = ((36e-6, 0.0, 0.0), (0.0, 1.5e-4, 0.0), (0.0, 0.0, 1.2e-3))
SIZES = ("r35", "r48", "r58", "r70")
GOOD = DetectorRates(false_alarms_per_ping=0.02, precision=0.95, found=0.9)
SIDEWAYS = PlanarPose(0.0, 0.15, 0.0)


def seen(range_m=1.5, azimuth_deg=0.0, label="r48", p=0.99):
    rest = (1.0 - p) / 5
    told = {name: p if name == label else rest for name in (*SIZES, "none", "unknown")}
    return Detection(label, told, range_m, math.radians(azimuth_deg), 0.0, COVARIANCE, 25.0, 0.2)


def weak(range_m=1.5, p=0.3):
    """A landmark with probability 0.3, else nothing."""
    sure = seen(range_m)
    return dataclasses.replace(sure, probabilities={"r48": p, "none": 1.0 - p, "unknown": 0.0})


def states(tracks):
    return [(track.track_id, track.state) for track in tracks]


class Walk:
    """A sensor that goes sideways past things that stand still; it knows how it moves."""

    def __init__(self, tracker, step=SIDEWAYS, *, odometry=True):
        self.tracker, self.step, self.odometry = tracker, step, odometry
        self.pose, self.ping = PlanarPose(0.0, 0.0, 0.0), 0
        self.stepped = step  # since the ping before

    def see(self, x_m, y_m, **told):
        place = PlanarPose(x_m, y_m, 0.0).seen_from(self.pose)
        angle = math.degrees(math.atan2(place.y_m, place.x_m))
        return seen(math.hypot(place.x_m, place.y_m), angle, **told)

    def hear(self, *things, **told):
        """One ping with these things, each (x_m, y_m)."""
        tracks = self.tracker.update(
            [self.see(x, y, **told) for x, y in things], self.ping * PERIOD_NS, self._motion()
        )
        self.pose, self.ping, self.stepped = self.pose.then(self.step), self.ping + 1, self.step
        return tracks

    def _motion(self):
        if not self.ping or not self.odometry:
            return None
        return Motion.between(PlanarPose(0.0, 0.0, 0.0), self.stepped)


def announced(walk, *things, pings=8):
    """Ping until something is announced; its tracks."""
    for _ in range(pings):
        tracks = walk.hear(*things)
        if tracks:
            return tracks
    return pytest.fail(f"nothing announced in {pings} pings")


def test_one_detection_is_not_announced_and_some_from_several_sides_are():
    walk = Walk(Tracker(GOOD))
    assert walk.hear((2.0, 0.3)) == []
    (track,) = announced(walk, (2.0, 0.3))
    assert (track.track_id, track.state, track.detection.label) == (1, "new", "r48")
    assert walk.ping <= 4
    assert states(walk.hear((2.0, 0.3))) == [(1, "update")]


def test_the_same_echo_from_the_same_spot_is_no_new_evidence():
    walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.0, 0.0))
    assert [walk.hear((2.0, 0.3)) for _ in range(200)] == [[]] * 200


def test_going_round_counts_only_if_odometry_tells_it_from_turning():
    patience = []
    for odometry in (True, False):
        walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.04, 0.0), odometry=odometry)
        announced(walk, (2.0, 0.6), pings=40)
        patience.append(walk.ping)
    assert patience[0] < patience[1]


def test_one_strong_detection_is_announced_at_once_where_the_rate_allows():
    settings = TrackerSettings(max_false_events_per_hour=600.0)
    (track,) = Tracker(GOOD, settings).update([seen(p=0.9999)], 0)
    assert (track.state, track.detection.label) == ("new", "r48")
    assert Tracker(GOOD).update([seen(p=0.9999)], 0) == []


def test_a_lower_rate_of_false_events_asks_for_more_evidence():
    patience = []
    for per_hour in (60.0, 1.0, 0.01):
        walk = Walk(Tracker(GOOD, TrackerSettings(max_false_events_per_hour=per_hour)))
        walk.step = PlanarPose(0.0, 0.05, 0.0)
        announced(walk, (2.0, 0.5), pings=15)
        patience.append(walk.ping)
    assert patience[0] < patience[1] < patience[2]


def test_the_threshold_is_the_alarms_an_hour_over_those_allowed():
    settings = TrackerSettings(max_false_events_per_hour=2.0, ping_rate_hz=10.0)
    rare = DetectorRates(false_alarms_per_ping=0.01)
    often = DetectorRates(false_alarms_per_ping=0.1)
    more = settings.least_existence(often) - settings.least_existence(rare)
    assert more == pytest.approx(math.log(10.0))
    # Four fifths of what is allowed is for what is no landmark.
    assert settings.least_existence(rare) == pytest.approx(math.log(360.0 / 1.6))
    assert settings.least_size_probability == pytest.approx(1 - 0.4 / 60)


def test_a_less_probable_detection_starts_nothing_and_is_no_silence_of_what_is_followed():
    tracker = Tracker(GOOD)
    assert tracker.update([weak()], 0) == []
    assert tracker.followed == ()
    believed = {}
    for name, second in (("weakly heard", [weak()]), ("silent", [])):
        tracker = Tracker(GOOD)
        tracker.update([seen(p=0.99)], 0)
        tracker.update(second, PERIOD_NS)
        (one,) = tracker.followed
        believed[name] = one.evidence.existence
        assert (one.silence < 0.0) == (name == "silent")
    assert believed["weakly heard"] > believed["silent"] + 1.0


def test_a_less_probable_detection_elsewhere_is_not_taken_for_what_is_followed():
    tracker = Tracker(GOOD)
    tracker.update([seen(1.5, p=0.99)], 0)
    tracker.update([weak(1.9)], PERIOD_NS)
    (one,) = tracker.followed
    assert one.silence < 0.0


def test_where_tracks_start_is_asked_for():
    tracker = Tracker(GOOD, TrackerSettings(start_probability=0.3))
    tracker.update([weak(p=0.31)], 0)
    assert len(tracker.followed) == 1


def test_sizes_that_contradict_each_other_are_not_announced():
    walk = Walk(Tracker(GOOD))
    for n in range(12):
        assert walk.hear((2.0, 0.9), label=("r58", "r70")[n % 2]) == []


def test_what_every_ping_calls_half_a_landmark_is_not_announced():
    walk = Walk(Tracker(GOOD))
    assert [walk.hear((2.0, 0.9), p=0.6) for _ in range(12)] == [[]] * 12


def test_a_track_whose_size_flips_is_lost_and_announced_anew():
    walk = Walk(Tracker(GOOD), PlanarPose(0.05, 0.08, 0.0))
    (first,) = announced(walk, (3.5, 0.4))
    told = [track for _ in range(9) for track in walk.hear((3.5, 0.4), label="r58", p=0.999)]
    lost = next(track for track in told if track.state == "lost")
    new = next(track for track in told if track.state == "new")
    assert (lost.track_id, lost.detection.label) == (first.track_id, "r48")
    assert (new.track_id, new.detection.label) == (2, "r58")
    assert all(t.detection.label == "r48" for t in told if t.track_id == 1)


def test_probabilities_accumulate_and_sum_to_one():
    walk = Walk(Tracker(GOOD))
    (track,) = announced(walk, (2.0, 0.3))
    told = track.detection.probabilities
    assert set(told) == {*SIZES, "none", "unknown"}
    assert sum(told.values()) == pytest.approx(1.0)
    assert told["r48"] > 0.99 > seen().probabilities["r48"] - 0.01
    assert (track.detection.snr_db, track.detection.tilt_rad) == (25.0, 0.2)


def test_the_fused_place_is_the_true_one_and_surer_than_one_ping():
    rng = np.random.default_rng(3)
    walk = Walk(Tracker(GOOD), PlanarPose(0.03, 0.08, 0.01))
    for _ in range(9):
        place = PlanarPose(3.0, 0.6, 0.0).seen_from(walk.pose)
        wrong = walk.see(3.0 + rng.normal(0, 0.006), 0.6 + rng.normal(0, 0.02))
        tracks = walk.tracker.update([wrong], walk.ping * PERIOD_NS, walk._motion())
        walk.pose, walk.ping = walk.pose.then(walk.step), walk.ping + 1
    fused = tracks[0].detection
    assert fused.range_m == pytest.approx(math.hypot(place.x_m, place.y_m), abs=0.012)
    assert fused.azimuth_rad == pytest.approx(math.atan2(place.y_m, place.x_m), abs=0.015)
    variances = np.diag(fused.covariance)
    assert (variances > 0).all()
    assert variances[0] < 0.9 * COVARIANCE[0][0]
    assert variances[1] < 0.6 * COVARIANCE[1][1]


def test_after_long_silence_in_view_it_is_lost_once_with_its_last_report():
    walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.06, 0.0))
    (last,) = announced(walk, (2.5, 0.4), pings=12)
    silence = []
    while not silence:
        assert walk.ping < 60
        silence = walk.hear()
    assert states(silence) == [(1, "lost")]
    assert silence[0].detection is last.detection
    assert walk.hear() == []


def test_a_short_silence_is_forgiven():
    walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.06, 0.0))
    announced(walk, (2.5, 0.4), pings=12)
    assert [walk.hear(), walk.hear()] == [[], []]
    assert states(walk.hear((2.5, 0.4))) == [(1, "update")]


def test_what_turns_out_to_be_none_is_withdrawn():
    walk = Walk(Tracker(GOOD), PlanarPose(0.05, 0.08, 0.0))
    announced(walk, (3.5, 0.4))
    told = [track for _ in range(12) for track in walk.hear((3.5, 0.4), label="unknown", p=0.999)]
    assert states(told)[-1] == (1, "lost")
    assert told[-1].detection.label == "r48"


def test_what_left_the_field_of_view_is_kept_until_it_returns_or_is_forgotten():
    walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.06, 0.0))
    announced(walk, (2.5, 0.4), pings=12)
    walk.step = PlanarPose(0.0, 0.0, math.radians(40.0))
    walk.hear((2.5, 0.4))
    walk.step = PlanarPose(0.0, 0.0, 0.0)
    assert [walk.hear() for _ in range(40)] == [[]] * 40  # 6 s, turned away
    walk.step = PlanarPose(0.0, 0.0, math.radians(-40.0))
    walk.hear()
    walk.step = PlanarPose(0.0, 0.0, 0.0)
    assert states(walk.hear((2.5, 0.4))) == [(1, "update")]
    late = walk.tracker.update([], (walk.ping + 80) * PERIOD_NS)
    assert states(late) == [(1, "lost")]


def test_what_is_too_near_to_be_heard_is_not_lost_for_its_silence():
    walk = Walk(Tracker(GOOD), PlanarPose(0.0, 0.05, 0.0))
    announced(walk, (0.95, 0.15), pings=12)
    walk.step = PlanarPose(0.4, 0.0, 0.0)
    walk.hear((0.95, 0.15))
    walk.step = PlanarPose(0.0, 0.0, 0.0)
    assert [walk.hear() for _ in range(30)] == [[]] * 30  # 4.5 s
    walk.step = PlanarPose(-0.4, 0.0, 0.0)
    walk.hear()
    assert states(walk.hear((0.95, 0.15))) == [(1, "update")]


def test_two_of_the_same_size_keep_their_numbers_in_any_order():
    walk = Walk(Tracker(GOOD), PlanarPose(0.06, 0.1, 0.0))
    left, right = (2.5, 0.5), (2.5, -0.1)
    orders = set()
    for n in range(8):
        tracks = walk.hear(*((left, right) if n % 2 else (right, left)))
        if len(tracks) == 2:
            from_left = sorted(tracks, key=lambda track: -track.detection.azimuth_rad)
            orders.add(tuple(track.track_id for track in from_left))
    assert orders in ({(1, 2)}, {(2, 1)})


def test_without_odometry_a_landmark_is_followed_within_the_limits_of_speed():
    settings = TrackerSettings(max_false_events_per_hour=600.0, max_speed_m_s=1.0)
    tracker = Tracker(GOOD, settings)
    assert states(tracker.update([seen(3.0, p=0.9999)], 0)) == [(1, "new")]
    for ping in range(1, 12):
        nearer = seen(3.0 - 0.1 * ping, p=0.9999)
        (track,) = tracker.update([nearer], ping * PERIOD_NS)
        assert (track.track_id, track.state) == (1, "update")
        assert track.detection.range_m == pytest.approx(nearer.range_m, abs=0.02)
    elsewhere = seen(3.5, p=0.9999)
    assert states(tracker.update([elsewhere], 12 * PERIOD_NS)) == [(2, "new")]


def test_time_that_goes_back_ends_all_tracks_and_starts_again():
    walk = Walk(Tracker(GOOD))
    announced(walk, (2.0, 0.3))
    assert states(walk.tracker.update([seen()], 0)) == [(1, "lost")]
    walk.ping, walk.pose = 1, PlanarPose(0.0, 0.0, 0.0)
    assert states(announced(walk, (2.0, 0.3))) == [(2, "new")]


def test_a_gap_longer_than_memory_ends_all_tracks():
    walk = Walk(Tracker(GOOD))
    announced(walk, (2.0, 0.3))
    late = walk.tracker.update([walk.see(2.0, 0.3)], 10**12)
    assert states(late) == [(1, "lost")]


def test_numbers_are_never_used_twice_and_not_shared_between_trackers():
    settings = TrackerSettings(max_false_events_per_hour=600.0)
    tracker, given = Tracker(GOOD, settings), []
    for ping in range(5):
        tracks = tracker.update([seen(p=0.9999)], ping * 20_000_000_000)
        given += [t.track_id for t in tracks if t.state == "new"]
    assert given == [1, 2, 3, 4, 5]
    assert states(Tracker(GOOD, settings).update([seen(p=0.9999)], 0)) == [(1, "new")]


def test_a_flood_of_detections_stays_bounded():
    rng, tracker = np.random.default_rng(1), Tracker(GOOD)
    for ping in range(20):
        flood = [seen(*rng.uniform((0.7, -30), (4.5, 30))) for _ in range(100)]
        tracker.update(flood, ping * PERIOD_NS)
        assert len(tracker._followed) <= (MAX_FOLLOWED if ping else MAX_TAKEN)


def test_what_was_announced_is_not_crowded_out_by_what_may_turn_out_to_be_nothing():
    walk = Walk(Tracker(GOOD))
    announced(walk, (2.0, 0.3))
    tracks = [track for _ in range(4) for track in walk.hear()]  # silent, but not for long
    for x_m in (3.0, 3.5):
        tracks += walk.hear(*((x_m, 0.1 * y) for y in range(-8, 8)))
    assert tracks == []
    assert len(walk.tracker._followed) == MAX_FOLLOWED


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_a_detection_that_is_nowhere_is_left_out(value):
    tracker = Tracker(GOOD, TrackerSettings(max_false_events_per_hour=600.0))
    assert states(tracker.update([seen(value), seen(p=0.9999)], 0)) == [(1, "new")]


def test_a_model_with_other_sizes_or_without_any_is_followed_too():
    settings = TrackerSettings(max_false_events_per_hour=600.0)
    own = Detection("r90", {"r90": 0.9999, "none": 1e-4}, 1.5, 0.0, 0.0, COVARIANCE, 25.0)
    (track,) = Tracker(GOOD, settings).update([own], 0)
    assert track.detection.label == "r90"
    assert set(track.detection.probabilities) == {"r90", "none", "unknown"}
    nothing = Detection("none", {"none": 1.0}, 1.5, 0.0, 0.0, COVARIANCE, 25.0)
    assert Tracker(GOOD, settings).update([nothing], 0) == []
