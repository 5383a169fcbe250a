import numpy as np
import pytest
from scipy.special import j0

from ertis_simulator.landmark import RADII_MM, RING_POINTS, Dish, dish_echoes, lit_fraction

C_M_S = 343.0
FAR_M = 500.0  # wavefronts there are flat over a dish: nothing but its own geometry is left
VERTEX, RING2, RING3 = slice(0, 1), slice(1, 1 + RING_POINTS), slice(13, 13 + RING_POINTS)
TOWARD_SONAR = np.array([-1.0, 0.0, 0.0])
radii = pytest.mark.parametrize("radius_mm", RADII_MM)


def echoes_of(dish, axis=TOWARD_SONAR, at=(FAR_M, 0.0, 0.0), emitter=(0.0, 0.0, 0.0), mic=None):
    mics = np.array([emitter if mic is None else mic], float)
    return dish_echoes(dish, axis, np.array(at), np.array(emitter, float), mics)


def scattered(echoes, part, frequency_hz):
    """Complex sum of some echoes at one frequency, for the first microphone."""
    k = 2 * np.pi * frequency_hz / C_M_S
    waves = echoes.gain[:, 0] * k**echoes.exponent * np.exp(1j * k * echoes.path_m[:, 0])
    return waves[part].sum()


def turned(degrees):
    return np.array([-np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees)), 0.0])


@radii
def test_a_landmark_is_60_percent_as_deep_as_its_aperture_is_wide(radius_mm):
    dish = Dish.landmark(radius_mm)
    assert dish.sphere_radius_m == pytest.approx(1.1333e-3 * radius_mm, rel=1e-4)
    assert np.rad2deg(dish.half_opening_rad) == pytest.approx(61.9, abs=0.1)


@radii
@pytest.mark.parametrize(
    ("ring", "us_per_mm"),
    [(RING2, (2 * np.sqrt(2) - 2) * 1.13333 / 0.343), (RING3, 1.13333 / 0.343)],
)
def test_the_rings_follow_the_vertex_by_their_longer_way(radius_mm, ring, us_per_mm):
    path = echoes_of(Dish.landmark(radius_mm)).path_m[:, 0]
    behind_us = (path[ring] - path[VERTEX]) / C_M_S * 1e6
    np.testing.assert_allclose(behind_us, us_per_mm * radius_mm, rtol=5e-4)


def test_the_delays_per_mm_are_those_the_project_names():
    path = echoes_of(Dish(1.0, 0.6), at=(1e6, 0.0, 0.0)).path_m[:, 0]
    us_per_mm = (path - path[0]) / C_M_S * 1e3
    assert us_per_mm[RING2].mean() == pytest.approx(2.74, abs=0.006)
    assert us_per_mm[RING3].mean() == pytest.approx(3.30, abs=0.006)


def test_the_vertex_returns_after_the_way_to_it_and_back():
    emitter, mic, at = np.zeros(3), np.array([0.0, 0.03, 0.0]), np.array([2.0, 0.0, 0.0])
    path = echoes_of(Dish.landmark(48), at=at, emitter=emitter, mic=mic).path_m[0, 0]
    exact = np.linalg.norm(at - emitter) + np.linalg.norm(at - mic)
    assert path == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("tilt_deg", [0, 10, 20, 30, 40])
def test_the_delays_do_not_change_with_tilt(tilt_deg):
    dish = Dish.landmark(58)
    at = np.array([FAR_M, 0.0, 0.0]) + dish.sphere_radius_m * (TOWARD_SONAR - turned(tilt_deg))
    path = echoes_of(dish, turned(tilt_deg), at).path_m[:, 0]
    frontal = echoes_of(dish).path_m[:, 0]
    np.testing.assert_allclose(path[:25], frontal[:25], atol=1e-6)


@pytest.mark.parametrize("incidence_rad", [np.pi / 4, np.pi / 3])
def test_a_frontal_ring_is_lit_all_around(incidence_rad):
    alpha = Dish.landmark(48).half_opening_rad
    assert lit_fraction(np.array(1e-6), incidence_rad, alpha) == pytest.approx(1.0)


def test_tilt_darkens_the_two_bounce_ring_and_puts_it_out_at_the_limiting_angle():
    alpha = Dish.landmark(48).half_opening_rad
    tilt_deg = np.array([16.0, 20.0, 30.0, 40.0, 45.0, 49.0, 60.0, 89.0])
    lit = lit_fraction(np.deg2rad(tilt_deg), np.pi / 4, alpha)
    assert np.all(np.diff(lit) <= 0)
    assert lit[0] == 1.0
    assert 0.5 < lit[1] < 0.7
    assert lit[3] == pytest.approx(0.1, abs=0.02)
    assert lit[4] < 0.05
    np.testing.assert_array_equal(lit[5:], 0.0)


def test_the_lit_fraction_is_the_share_of_ring_points_that_see_out():
    """Count the points of a tilted ring whose first and last bounce both lie on the cap."""
    alpha, incidence = Dish.landmark(48).half_opening_rad, np.pi / 4
    around = 2 * np.pi * (np.arange(100_000) + 0.5) / 100_000
    for tilt in np.deg2rad([10.0, 20.0, 30.0, 40.0]):
        height = np.cos(tilt) * np.cos(incidence)
        swing = np.sin(tilt) * np.sin(incidence) * np.cos(around)
        on_cap = (height + swing >= np.cos(alpha)) & (height - swing >= np.cos(alpha))
        assert lit_fraction(tilt, incidence, alpha) == pytest.approx(on_cap.mean(), abs=1e-3)


@pytest.mark.parametrize("frequency_hz", [30e3, 50e3, 80e3])
def test_size_is_a_pure_scale(frequency_hz):
    """Half the dish, at half the distance and twice the frequency, scatters the same."""
    small, large = Dish.landmark(35), Dish.landmark(70)
    for axis in (turned(5), turned(25)):
        near = echoes_of(small, axis, (1.0, 0.0, 0.0), mic=(0.0, 0.02, 0.01))
        far = echoes_of(large, axis, (2.0, 0.0, 0.0), mic=(0.0, 0.04, 0.02))
        one = scattered(near, slice(None), 2 * frequency_hz) * 1.0
        other = scattered(far, slice(None), frequency_hz) * 2.0
        assert one == pytest.approx(other, rel=1e-6)


@radii
def test_the_two_bounce_ring_stands_some_20_db_above_the_vertex(radius_mm):
    echoes = echoes_of(Dish.landmark(radius_mm))
    ratio = abs(scattered(echoes, RING2, 50e3) / scattered(echoes, VERTEX, 50e3))
    assert 17 < 20 * np.log10(ratio) < 25


def test_the_vertex_scatters_as_half_the_sphere_radius():
    dish = Dish.landmark(70)
    echoes = echoes_of(dish)
    distance = FAR_M - dish.sphere_radius_m
    assert abs(echoes.gain[0, 0]) * distance**2 == pytest.approx(dish.sphere_radius_m / 2, rel=1e-3)


@pytest.mark.parametrize("frequency_hz", [25e3, 50e3, 80e3])
def test_a_ring_loses_its_focus_by_the_bessel_function_between_emitter_and_microphone(frequency_hz):
    dish, distance = Dish.landmark(70), 2.0
    k = 2 * np.pi * frequency_hz / C_M_S
    together = scattered(echoes_of(dish, at=(distance, 0, 0)), RING2, frequency_hz)
    for apart_m in (0.02, 0.05, 0.08):
        echoes = echoes_of(dish, at=(distance, 0.0, 0.0), mic=(0.0, apart_m, 0.0))
        gamma = apart_m / (distance - dish.sphere_radius_m)
        ring_radius = dish.sphere_radius_m / np.sqrt(2)
        found = abs(scattered(echoes, RING2, frequency_hz)) / abs(together)
        assert found == pytest.approx(abs(j0(k * ring_radius * gamma)), abs=0.02)


@pytest.mark.parametrize("tilt_deg", [0, 15, 35])
def test_emitter_and_microphone_may_be_swapped(tilt_deg):
    dish, at = Dish.landmark(48), (1.2, 0.2, -0.1)
    here, there = (0.0, 0.0, 0.051), (0.0, 0.04, -0.02)
    one = echoes_of(dish, turned(tilt_deg), at, emitter=here, mic=there)
    other = echoes_of(dish, turned(tilt_deg), at, emitter=there, mic=here)
    for frequency_hz in (25e3, 50e3, 80e3):
        assert scattered(one, slice(None), frequency_hz) == pytest.approx(
            scattered(other, slice(None), frequency_hz), rel=1e-9
        )


def test_a_dish_seen_from_behind_returns_next_to_nothing():
    behind = echoes_of(Dish.landmark(48), -TOWARD_SONAR)
    frontal = echoes_of(Dish.landmark(48))
    assert np.abs(behind.gain).sum() < 1e-3 * np.abs(frontal.gain).sum()
