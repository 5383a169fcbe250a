import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_daemon.config import OdometryConfig, PoseConfig
from ertis_daemon.odometry import MAX_PAYLOAD_BYTES, POSES_WAITING, Odometry

MS = 1_000_000


def pose(time_ms, x_m=0.0, y_m=0.0, yaw_rad=0.0):
    return json.dumps(
        {"time_ns": time_ms * MS, "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}
    ).encode()


def told(*samples, on_robot=None, **config):
    odometry = Odometry(OdometryConfig(key="robot/odometry", **config), on_robot)
    for sample in samples:
        odometry.add(sample)
    return odometry


def test_motion_is_interpolated_between_poses():
    odometry = told(pose(0), pose(100, 0.1), pose(200, 0.3), pose(300, 0.3, yaw_rad=0.2))
    first = odometry.at_ping(50 * MS)
    assert (first.motion, first.is_known, first.garbled) == (None, True, 0)
    step = odometry.at_ping(150 * MS).motion.step
    assert (step.x_m, step.y_m, step.yaw_rad) == pytest.approx((0.15, 0.0, 0.0))
    step = odometry.at_ping(250 * MS).motion.step
    assert (step.x_m, step.yaw_rad) == pytest.approx((0.1, 0.1))


def test_a_heading_goes_the_short_way_round():
    odometry = told(pose(0, yaw_rad=3.1), pose(100, yaw_rad=-3.1))
    odometry.at_ping(0)
    turned = odometry.at_ping(50 * MS).motion.step.yaw_rad
    assert turned == pytest.approx((2 * math.pi - 6.2) / 2)


def test_a_sonar_beside_the_robots_middle_swings_when_the_robot_turns():
    odometry = told(pose(0), pose(100, yaw_rad=0.1), on_robot=PoseConfig(x_m=0.5, yaw_deg=90.0))
    odometry.at_ping(0)
    step = odometry.at_ping(100 * MS).motion.step
    # The sonar looks left: the swing to the left is forward for it.
    assert (step.x_m, step.y_m) == pytest.approx((0.5 * math.sin(0.1), 0.5 * (1 - math.cos(0.1))))
    assert step.yaw_rad == pytest.approx(0.1)


def test_a_ping_after_the_latest_pose_is_guessed_and_less_sure():
    known = told(pose(0), pose(100, 0.1), pose(200, 0.2))
    guessed = told(pose(0), pose(100, 0.1))
    for odometry in (known, guessed):
        odometry.at_ping(50 * MS)
    motions = [odometry.at_ping(200 * MS).motion for odometry in (known, guessed)]
    assert motions[0].step.x_m == pytest.approx(0.15) == motions[1].step.x_m
    assert (np.diag(motions[1].covariance)[:2] > 10 * np.diag(motions[0].covariance)[:2]).all()


def test_a_turn_that_is_guessed_leaves_a_sonar_far_from_the_middle_less_sure_of_its_place():
    sigmas_m = []
    for x_m in (0.0, 0.5):
        odometry = told(pose(0), pose(100, yaw_rad=0.1), on_robot=PoseConfig(x_m=x_m))
        odometry.at_ping(100 * MS)
        covariance = odometry.at_ping(300 * MS).motion.covariance
        assert math.sqrt(covariance[2, 2]) == pytest.approx(0.1, rel=0.05), "half of 0.2 rad"
        sigmas_m.append(math.sqrt(covariance[0, 0]))
    assert sigmas_m[0] < 0.01
    assert sigmas_m[1] == pytest.approx(0.05, rel=0.1)


def test_a_ping_at_the_very_time_of_the_only_pose_is_there():
    assert told(pose(100, 0.3)).at_ping(100 * MS).is_known


@pytest.mark.parametrize(
    ("samples", "ping_ms"),
    [
        ((), 0),
        ((pose(100),), 50),
        ((pose(0),), 50),
        ((pose(0), pose(100)), 700),
        ((pose(0), pose(900)), 400),
    ],
)
def test_a_ping_that_odometry_does_not_reach_has_no_motion(samples, ping_ms):
    odometry = told(*samples, max_age_s=0.5)
    at_ping = odometry.at_ping(ping_ms * MS)
    assert (at_ping.motion, at_ping.is_known) == (None, False)


def test_after_a_ping_without_odometry_motion_starts_again():
    odometry = told(pose(0), pose(100, 0.1))
    assert odometry.at_ping(50 * MS).is_known
    assert not odometry.at_ping(900 * MS).is_known
    for sample in (pose(1000, 1.0), pose(1100, 1.1), pose(1200, 1.2)):
        odometry.add(sample)
    after = odometry.at_ping(1050 * MS)
    assert (after.is_known, after.motion) == (True, None)
    assert odometry.at_ping(1150 * MS).motion.step.x_m == pytest.approx(0.1)


@pytest.mark.parametrize(
    "again",
    [pose(699), pose(1201, 100.0), pose(1201, 0.2, yaw_rad=2.5), pose(1201, 0.2, 0.0, -2.5)],
)
def test_time_that_goes_back_and_a_pose_set_anew_start_odometry_again(again):
    odometry = told(pose(1000), pose(1200, 0.2), max_age_s=0.5)
    assert odometry.at_ping(1100 * MS).is_known
    odometry.add(again)
    assert not odometry.at_ping(1150 * MS).is_known


def test_a_pose_that_was_overtaken_on_the_way_changes_nothing():
    odometry = told(pose(1000), pose(1200, 0.2), pose(1100, 0.1), pose(700), max_age_s=0.5)
    assert odometry.at_ping(1050 * MS).is_known
    odometry.add(pose(1300, 0.3))
    assert odometry.at_ping(1250 * MS).motion.step.x_m == pytest.approx(0.2)


def test_a_pose_set_anew_is_no_motion():
    odometry = told(pose(0), pose(200, 0.2))
    odometry.at_ping(100 * MS)
    for sample in (pose(300, 100.0), pose(400, 100.1)):
        odometry.add(sample)
    after = odometry.at_ping(350 * MS)
    assert (after.is_known, after.motion) == (True, None)


def test_a_turn_across_the_back_is_no_jump():
    odometry = told(pose(0, yaw_rad=3.13), pose(10, yaw_rad=-3.13))
    odometry.at_ping(0)
    assert odometry.at_ping(10 * MS).motion.step.yaw_rad == pytest.approx(2 * math.pi - 6.26)


def test_poses_too_near_to_each_other_in_time_tell_no_speed():
    both = [
        json.dumps({"time_ns": 10**9 + late_ns, "x_m": x_m, "y_m": 0, "yaw_rad": 0}).encode()
        for late_ns, x_m in ((0, 0.0), (1000, 1e-4))
    ]
    assert not told(*both).at_ping(1050 * MS).is_known
    # An earlier one does.
    odometry = told(pose(900, -0.05), *both)
    odometry.at_ping(950 * MS)
    assert odometry.at_ping(1050 * MS).motion.step.x_m == pytest.approx(0.05, abs=1e-3)


def test_the_same_pose_twice_is_taken_once():
    odometry = told(pose(0), pose(100, 0.1), pose(100, 0.1), pose(200, 0.2))
    odometry.at_ping(0)
    assert odometry.at_ping(150 * MS).motion.step.x_m == pytest.approx(0.15)


@pytest.mark.parametrize(
    "garbled",
    [
        b"",
        b"\xff",
        b"[1, 2]",
        b"7",
        b"{}",
        b'{"time_ns": 1.5, "x_m": 0, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": -1, "x_m": 0, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": 9223372036854775808, "x_m": 0, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": 1' + b"0" * 310 + b', "x_m": 0, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": true, "x_m": 0, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": 1, "x_m": "0", "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": 1, "x_m": NaN, "y_m": 0, "yaw_rad": 0}',
        b'{"time_ns": 1, "x_m": 0, "y_m": 0, "yaw_rad": Infinity}',
        b'{"time_ns": 1, "x_m": 1' + b"0" * 400 + b', "y_m": 0, "yaw_rad": 0}',
        b"[" * 4000,
        b" " * (MAX_PAYLOAD_BYTES + 1),
    ],
)
def test_what_is_no_pose_is_counted_once_and_left_out(garbled):
    odometry = told(pose(0), garbled, pose(100, 0.1))
    assert odometry.at_ping(50 * MS).garbled == 1
    at_ping = odometry.at_ping(100 * MS)
    assert (at_ping.garbled, at_ping.motion.step.x_m) == (0, pytest.approx(0.05))


@given(st.lists(st.binary(max_size=60) | st.builds(pose, st.integers(0, 500)), max_size=20))
def test_any_bytes_in_any_order_are_survived(samples):
    odometry = told(*samples)
    odometry.at_ping(100 * MS)


def test_poses_are_bounded_and_the_newest_are_kept():
    odometry = told(*(pose(n, 0.001 * n) for n in range(3 * POSES_WAITING)))
    assert not odometry.at_ping(POSES_WAITING * MS).is_known
    assert odometry.at_ping((3 * POSES_WAITING - 5) * MS).is_known


def test_poses_that_wait_in_the_channel_are_read_at_the_ping():
    waiting = [pose(0), pose(100, 0.1), b"nonsense"]

    def try_recv():
        if not waiting:
            return None
        data = waiting.pop(0)
        return SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data))

    odometry = told()
    odometry.listen(SimpleNamespace(try_recv=try_recv))
    at_ping = odometry.at_ping(50 * MS)
    assert (at_ping.is_known, at_ping.garbled) == (True, 1)
