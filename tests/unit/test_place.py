import math

import numpy as np
import pytest

from ertis_detector.detection import Detection
from ertis_detector.motion import Motion, PlanarPose
from ertis_detector.place import NOISE_SHARE, STAYING_SHARE, Measured, Place
from ertis_detector.views import PLACE_LENGTHS

COVARIANCE = np.array([[36e-6, 2e-6, 0.0], [2e-6, 1.5e-4, 0.0], [0.0, 0.0, 1.2e-3]])
ROOT = np.linalg.cholesky(COVARIANCE)
START = PlanarPose(0.0, 0.0, 0.0)
NUM_WALKS = 250
# The mean of so many chi-squared values of 3 degrees of freedom, 99.9 %, and 5 % for what is linear
# in the filter and not in the world.
BAND = 3.3 * math.sqrt(6 / NUM_WALKS) + 0.15
STILL = Motion.between(START, START)


def measured(seen, covariance=COVARIANCE):
    return Measured(Detection("r48", {}, *seen, tuple(map(tuple, covariance)), 20.0))


def true_place(point, pose):
    flat = PlanarPose(point[0], point[1], 0.0).seen_from(pose)
    across = math.hypot(flat.x_m, flat.y_m)
    azimuth = math.atan2(flat.y_m, flat.x_m)
    return np.array([math.hypot(across, point[2]), azimuth, math.atan2(point[2], across)])


def follow(rng, step, pings, *, odometry):
    """Squared normalised error of the place after some pings, and its variances' shrinking.

    The errors are as the filter assumes: a part that stays, one that changes with the view, noise.
    """
    point = np.array([rng.uniform(1.5, 4.0), rng.uniform(-0.5, 0.5), rng.uniform(-0.1, 0.1)])
    pose, stays, slow = START, rng.normal(size=3), rng.normal(size=3)
    place = None
    for ping in range(pings):
        if ping:
            before, pose = pose, pose.then(step)
            exact = Motion.between(before, pose)
            if odometry:
                mean = [exact.step.x_m, exact.step.y_m, exact.step.yaw_rad]
                told = PlanarPose(*rng.multivariate_normal(mean, exact.covariance))
                place.move(Motion(told, exact.covariance), is_known=True)
            else:
                place.move(Motion.unknown(0.14, 1.0, 1.0), is_known=False)
            old, new = true_place(point, before), true_place(point, pose)
            view = [new[1] - old[1] + exact.step.yaw_rad, new[0] - old[0], new[1] - old[1]]
            alike = math.exp(-np.linalg.norm(np.array(view) / PLACE_LENGTHS))
            slow = alike * slow + math.sqrt(1 - alike**2) * rng.normal(size=3)
        error = math.sqrt(STAYING_SHARE) * stays + math.sqrt(NOISE_SHARE) * rng.normal(size=3)
        error = error + math.sqrt(1 - STAYING_SHARE - NOISE_SHARE) * slow
        heard = measured(true_place(point, pose) + ROOT @ error)
        if place is None:
            place = Place(heard)
        else:
            place.update(heard)
    gap = place.seen - true_place(point, pose)
    covariance = place.seen_covariance()
    return gap @ np.linalg.solve(covariance, gap), np.diag(covariance) / np.diag(COVARIANCE)


@pytest.mark.parametrize(
    ("step", "pings"),
    [
        (PlanarPose(0.0, 0.0, 0.0), 6),
        (PlanarPose(0.03, 0.06, 0.01), 3),
        (PlanarPose(0.05, 0.0, -0.02), 10),
    ],
)
def test_the_stated_covariance_is_the_true_one(step, pings):
    rng = np.random.default_rng(8)
    squared = [follow(rng, step, pings, odometry=True)[0] for _ in range(NUM_WALKS)]
    assert np.mean(squared) == pytest.approx(3.0, abs=BAND)


def test_without_odometry_the_stated_covariance_is_rather_too_large():
    rng = np.random.default_rng(8)
    step = PlanarPose(0.05, 0.02, 0.03)
    squared = [follow(rng, step, 6, odometry=False)[0] for _ in range(NUM_WALKS)]
    assert 2.0 < np.mean(squared) < 3.0 + BAND


def test_on_a_straight_way_the_place_is_the_best_linear_estimate():
    """Range alone, ahead: the estimate of least variance, from the covariance of all errors."""
    rng, step_m, num_pings = np.random.default_rng(3), 0.03, 6
    variance = measured((2.0, 0.0, 0.0), np.diag(np.diag(COVARIANCE))).noise[0, 0]
    alike = math.exp(-step_m / PLACE_LENGTHS[1])
    ping = np.arange(num_pings)
    slow = (1 - STAYING_SHARE - NOISE_SHARE) * alike ** np.abs(ping[:, None] - ping)
    spread = variance * (slow + NOISE_SHARE * np.eye(num_pings))
    weights = np.linalg.solve(spread, np.ones(num_pings))
    errors_m = rng.multivariate_normal(np.zeros(num_pings), spread)
    forward = Motion(PlanarPose(step_m, 0.0, 0.0), np.zeros((3, 3)))
    place = None
    for n, error_m in enumerate(errors_m):
        heard = measured((2.0 - n * step_m + error_m, 0.0, 0.0), np.diag(np.diag(COVARIANCE)))
        if place is None:
            place = Place(heard)
            continue
        place.move(forward, is_known=True)
        place.update(heard)
    best_m = 2.0 - step_m * (num_pings - 1) + weights @ errors_m / weights.sum()
    assert place.seen[0] == pytest.approx(best_m, abs=0.02 * math.sqrt(variance))
    stated = place.seen_covariance()[0, 0]
    assert stated == pytest.approx(1 / weights.sum() + STAYING_SHARE * variance, rel=0.01)


def test_what_odometry_does_not_know_spreads_the_place_as_it_spreads_true_ones():
    seen, step = (2.0, 0.5, 0.2), PlanarPose(0.1, -0.05, 0.2)
    covariance = np.array([[4e-6, 1e-6, 2e-6], [1e-6, 9e-6, -3e-6], [2e-6, -3e-6, 1.6e-5]])
    known, told = Place(measured(seen)), Place(measured(seen))
    known.move(Motion(step, np.zeros((3, 3))), is_known=True)
    told.move(Motion(step, covariance), is_known=True)
    across = seen[0] * math.cos(seen[2])
    point = np.array([across * math.cos(seen[1]), across * math.sin(seen[1]), 0.0])
    point[2] = seen[0] * math.sin(seen[2])
    mean = [step.x_m, step.y_m, step.yaw_rad]
    drawn = np.random.default_rng(5).multivariate_normal(mean, covariance, 5000)
    true = np.cov([true_place(point, PlanarPose(*one)) for one in drawn], rowvar=False)
    added = told.seen_covariance() - known.seen_covariance()
    scale = np.sqrt(np.outer(true.diagonal(), true.diagonal()))
    assert added / scale == pytest.approx(true / scale, abs=0.06)


@pytest.mark.parametrize("is_known", [True, False])
def test_a_sensor_that_does_not_step_is_one_that_steps_by_nearly_nothing(is_known):
    covariance = Motion.unknown(0.14, 1.0, 1.0).covariance
    places = []
    for step in (PlanarPose(0.0, 0.0, 0.0), PlanarPose(1e-12, 0.0, 0.0)):
        place = Place(measured((2.0, 0.5, 0.2)))
        place.update(measured((2.01, 0.5, 0.2)))
        assert place.move(Motion(step, covariance), is_known=is_known) == pytest.approx(0.0)
        place.update(measured((2.0, 0.51, 0.2)))
        places.append(place)
    assert places[0].seen == pytest.approx(places[1].seen)
    assert places[0].seen_covariance() == pytest.approx(places[1].seen_covariance(), rel=1e-6)


def test_standing_still_makes_a_place_no_surer_than_its_noise_and_moving_does():
    rng = np.random.default_rng(1)
    _, still = follow(rng, PlanarPose(0.0, 0.0, 0.0), 30, odometry=True)
    _, moving = follow(rng, PlanarPose(0.0, 0.05, 0.0), 30, odometry=True)
    assert (still > 0.88).all()
    assert (still <= 1.05).all()
    assert moving[1] < 0.6


def test_a_turn_moves_the_place_to_the_other_side():
    place = Place(measured((2.0, 0.1, 0.05)))
    place.move(Motion(PlanarPose(0.0, 0.0, 0.3), np.zeros((3, 3))), is_known=True)
    assert place.seen == pytest.approx([2.0, -0.2, 0.05])


def test_the_line_of_sight_turns_when_the_sensor_goes_by_and_not_when_it_turns():
    place = Place(measured((2.0, 0.0, 0.0)))
    assert place.move(Motion(PlanarPose(0.0, 0.0, 0.5), np.zeros((3, 3))), is_known=True) == (
        pytest.approx(0.0)
    )
    place = Place(measured((2.0, 0.0, 0.0)))
    aside = Motion(PlanarPose(0.0, 0.2, 0.0), np.zeros((3, 3)))
    assert place.move(aside, is_known=True) == pytest.approx(-math.atan(0.1))
    assert Place(measured((2.0, 0.0, 0.0))).move(aside, is_known=False) == 0.0


def test_a_detection_behind_the_seam_of_angles_is_near():
    place = Place(measured((2.0, math.pi - 0.001, 0.0)))
    squared, _ = place.surprise(measured((2.0, -math.pi + 0.001, 0.0)))
    assert squared < 0.1


def test_no_covariance_at_all_is_not_believed():
    place = Place(measured((2.0, 0.1, 0.0), np.zeros((3, 3))))
    place.move(STILL, is_known=True)
    place.update(measured((2.0, 0.1, 0.0), np.zeros((3, 3))))
    assert (np.linalg.eigvalsh(place.seen_covariance()) > 0).all()


def test_a_thousand_pings_leave_the_covariance_positive():
    rng, place = np.random.default_rng(2), Place(measured((2.0, 0.1, 0.0)))
    for _ in range(1000):
        place.move(STILL, is_known=True)
        place.update(measured((2.0, 0.1, 0.0) + ROOT @ rng.normal(size=3)))
    covariance = place.seen_covariance()
    assert np.allclose(covariance, covariance.T)
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert place.seen == pytest.approx([2.0, 0.1, 0.0], abs=0.1)
