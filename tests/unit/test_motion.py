import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_detector.motion import Motion, PlanarPose, wrap

lengths = st.floats(-50.0, 50.0)
angles = st.floats(-3.0, 3.0)
poses = st.builds(PlanarPose, lengths, lengths, angles)


@given(poses, poses)
def test_a_pose_seen_from_another_leads_back_to_itself(a, b):
    back = a.then(b.seen_from(a))
    assert (back.x_m, back.y_m) == pytest.approx((b.x_m, b.y_m), abs=1e-9)
    assert wrap(back.yaw_rad - b.yaw_rad) == pytest.approx(0.0, abs=1e-9)


def test_a_step_is_told_in_the_frame_of_the_sensor_that_made_it():
    north = PlanarPose(1.0, 1.0, math.pi / 2)
    step = Motion.between(north, PlanarPose(0.8, 1.5, math.pi / 2 + 0.1)).step
    assert (step.x_m, step.y_m, step.yaw_rad) == pytest.approx((0.5, 0.2, 0.1))


@given(st.floats(-1000.0, 1000.0))
def test_a_wrapped_angle_is_the_same_direction(angle):
    assert -math.pi < wrap(angle) <= math.pi
    assert math.cos(wrap(angle)) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrap(angle)) == pytest.approx(math.sin(angle), abs=1e-9)


def test_wheels_are_less_sure_the_farther_they_went():
    start = PlanarPose(0.0, 0.0, 0.0)
    still, far = (Motion.between(start, PlanarPose(x, 0.0, 0.0)).covariance for x in (0.0, 2.0))
    assert (np.diag(still) > 0).all()
    assert (np.diag(far) > 10 * np.diag(still)).all()


def test_an_unknown_motion_is_as_wide_as_its_limits_in_two_sigma():
    covariance = Motion.unknown(0.5, 2.0, 1.0).covariance
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.5, 0.5, 0.25])


def test_less_than_four_sigma_is_no_motion_for_sure():
    covariance = np.diag([1e-6, 1e-6, 1e-6])
    assert not Motion(PlanarPose(3e-3, -3e-3, 3e-3), covariance).is_more_than_noise()
    assert Motion(PlanarPose(0.0, 0.0, -5e-3), covariance).is_more_than_noise()
