import numpy as np
import pytest
from scipy.optimize import brentq

from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.circles import RIM, RING_2, RING_3, VERTEX
from ertis_simulator.glints import glints, ring
from ertis_simulator.landmark import RADII_MM, Dish, dish_echoes
from ertis_simulator.physical_optics import CapOptics
from ertis_simulator.rim import rim_orders

C_M_S = 343.0
FAR_M = 500.0  # wavefronts there are flat over a dish: nothing but its own geometry is left
TOWARD_SONAR = np.array([-1.0, 0.0, 0.0])
EMITTER, MICS = np.array(EMITTER_POSITION_M), mic_positions_m()
radii = pytest.mark.parametrize("radius_mm", RADII_MM)


def turned(degrees):
    return np.array([-np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees)), 0.0])


def body_of(dish, axis=TOWARD_SONAR, at=(FAR_M, 0.0, 0.0), emitter=(0, 0, 0), mics=None, **rim):
    mics = np.array([emitter] if mics is None else mics, float)
    echoes = dish_echoes(dish, axis, np.array(at), np.array(emitter, float), mics, **rim)
    assert echoes.path_m.size == 0
    return echoes.responses[0].body


def heard(dish, frequency_hz, **where):
    """Pressure at the microphones, e^{-iwt}, shape (num_mics, num_frequencies)."""
    body, k = body_of(dish, **where), 2 * np.pi * np.atleast_1d(frequency_hz) / C_M_S
    return np.conj(body.spectrum(k)) * np.exp(1j * k * body.path_m[:, None])


def laid_for(dish, axis=TOWARD_SONAR, at=(FAR_M, 0.0, 0.0), emitter=(0, 0, 0), mic=None):
    centre = np.array(at) + dish.sphere_radius_m * axis
    mic = np.array(emitter if mic is None else mic, float)
    return glints(
        dish.aperture_radius_m, dish.depth_m, axis, np.array(emitter) - centre, mic[None] - centre
    )


def level_db(dish, tilt_deg, low_hz=20e3, high_hz=80e3):
    """Scattering length in dB re aperture radius, over the band, in the far field."""
    pressure = heard(dish, np.linspace(low_hz, high_hz, 121), axis=turned(tilt_deg))
    length = np.sqrt(np.mean(np.abs(pressure) ** 2)) * FAR_M**2
    return 20 * np.log10(length / dish.aperture_radius_m)


@radii
def test_a_landmark_is_60_percent_as_deep_as_its_aperture_is_wide(radius_mm):
    dish = Dish.landmark(radius_mm)
    assert dish.sphere_radius_m == pytest.approx(1.1333e-3 * radius_mm, rel=1e-4)
    assert np.rad2deg(dish.half_opening_rad) == pytest.approx(61.9, abs=0.1)


@radii
@pytest.mark.parametrize(
    ("circle", "us_per_mm"),
    [(RING_2, (2 * np.sqrt(2) - 2) * 1.13333 / 0.343), (RING_3, 1.13333 / 0.343)],
)
def test_the_rings_follow_the_vertex_by_their_longer_way(radius_mm, circle, us_per_mm):
    path = laid_for(Dish.landmark(radius_mm)).path_m[:, 0]
    behind_us = (path[circle] - path[VERTEX]) / C_M_S * 1e6
    np.testing.assert_allclose(behind_us, us_per_mm * radius_mm, rtol=5e-4)


@radii
@pytest.mark.parametrize("tilt_deg", [0, 15])
def test_the_strongest_echo_is_the_two_bounce_ring_when_it_should_arrive(radius_mm, tilt_deg):
    dish = Dish.landmark(radius_mm)
    frequency_hz = np.arange(20e3, 80e3, 250.0)
    at = np.array([FAR_M, 0.0, 0.0]) + dish.sphere_radius_m * (TOWARD_SONAR - turned(tilt_deg))
    pressure = heard(dish, frequency_hz, axis=turned(tilt_deg), at=at)[0]
    after_s = np.arange(-100e-6, 500e-6, 1e-6)
    to_vertex = 2 * FAR_M
    turn = np.exp(-2j * np.pi * np.outer(after_s + to_vertex / C_M_S, frequency_hz))
    envelope = np.abs(turn @ (pressure * np.hanning(frequency_hz.size)))
    expected_s = 2.737e-6 * radius_mm
    assert after_s[np.argmax(envelope)] == pytest.approx(expected_s, abs=9e-6)


def test_the_vertex_returns_after_the_way_to_it_and_back():
    emitter, mic, at = np.zeros(3), np.array([0.0, 0.03, 0.0]), np.array([2.0, 0.0, 0.0])
    laid = laid_for(Dish.landmark(48), at=at, emitter=emitter, mic=mic)
    exact = np.linalg.norm(at - emitter) + np.linalg.norm(at - mic)
    assert laid.centre_path_m[0] + laid.path_m[VERTEX, 0] == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("tilt_deg", [0, 10, 20, 30, 40])
def test_the_delays_of_vertex_and_rings_do_not_change_with_tilt(tilt_deg):
    dish = Dish.landmark(58)
    at = np.array([FAR_M, 0.0, 0.0]) + dish.sphere_radius_m * (TOWARD_SONAR - turned(tilt_deg))
    path, frontal = laid_for(dish, turned(tilt_deg), at).path_m, laid_for(dish).path_m
    np.testing.assert_allclose(path[VERTEX : RING_3 + 1], frontal[VERTEX : RING_3 + 1], atol=1e-6)


@pytest.mark.parametrize("frequency_hz", [30e3, 50e3, 80e3])
def test_size_is_a_pure_scale(frequency_hz):
    """Half the dish, at half the distance and twice the frequency, scatters the same."""
    small, large = Dish.landmark(35), Dish.landmark(70)
    for axis in (turned(5), turned(25), turned(70), turned(150)):
        near = heard(small, 2 * frequency_hz, axis=axis, at=(1, 0, 0), mics=[(0, 0.02, 0.01)])
        far = heard(large, frequency_hz, axis=axis, at=(2, 0, 0), mics=[(0, 0.04, 0.02)])
        assert near[0, 0] == pytest.approx(2 * far[0, 0], rel=1e-3)


@radii
def test_a_frontal_dish_returns_mostly_rings(radius_mm):
    """By closed form b sqrt(2 pi ka R cos i / 4) for the first alone; half the radius without."""
    ka = 2 * np.pi * np.linspace(20e3, 80e3, 121) / C_M_S * radius_mm / 1000
    ring_db = 10 * np.log10(np.mean(0.8014**2 * 2 * np.pi * ka * 0.8014 / 4))
    found_db = level_db(Dish.landmark(radius_mm), 0.0)
    assert ring_db - 1 < found_db < ring_db + 3.5  # the rim and the third bounce add
    assert found_db > 20 * np.log10(1.1333 / 2) + 15


@radii
def test_tilt_darkens_the_rings_to_40_degrees_the_vertex_to_65_and_leaves_the_edge(radius_mm):
    dish = Dish.landmark(radius_mm)
    frontal, strong, limit, vertex, edge = (level_db(dish, t) for t in (0, 20, 45, 55, 78))
    assert -9 < strong - frontal < -1
    assert -28 < limit - frontal < -12
    assert vertex == pytest.approx(20 * np.log10(1.1333 / 2), abs=3.5)
    assert -35 < edge < vertex - 6


def test_strength_changes_smoothly_with_tilt():
    levels = np.array([level_db(Dish.landmark(48), t) for t in np.arange(0, 60, 1.0)])
    assert np.max(np.abs(np.diff(levels))) < 2.0


@pytest.mark.parametrize("tilt_deg", [0, 15, 35, 75, 140])
def test_emitter_and_microphone_may_be_swapped(tilt_deg):
    dish, at = Dish.landmark(48), (1.2, 0.2, -0.1)
    here, there = (0.0, 0.0, 0.051), (0.0, 0.04, -0.02)
    frequency_hz = np.array([25e3, 50e3, 75e3])
    one = heard(dish, frequency_hz, axis=turned(tilt_deg), at=at, emitter=here, mics=[there])
    other = heard(dish, frequency_hz, axis=turned(tilt_deg), at=at, emitter=there, mics=[here])
    np.testing.assert_allclose(one, other, rtol=2e-4)


@pytest.mark.parametrize(
    ("radius_mm", "range_m", "tilt_deg", "least"),
    [(35, 0.6, 5, 0.9), (70, 0.6, 20, 0.8), (48, 2.0, 12, 0.95), (58, 1.5, 35, 0.93)],
)
def test_every_microphone_hears_what_the_surface_integral_radiates(
    radius_mm, range_m, tilt_deg, least
):
    """Near field, emitter and microphones apart: against physical optics at the true places."""
    dish, axis = Dish.landmark(radius_mm), turned(tilt_deg)
    vertex, a = np.array([range_m, 0.1, 0.0]), dish.aperture_radius_m
    mics = MICS[::8]
    frame = np.array([np.cross(axis, [0, 0, 1]), np.cross(axis, np.cross(axis, [0, 0, 1])), axis])
    centre = vertex + dish.sphere_radius_m * axis
    ka = np.arange(18.0, 36.0, 1.5)
    optics = np.array(
        [
            CapOptics(0.6, each, points_per_wavelength=6).near_field(
                frame @ (EMITTER - centre) / a, (mics - centre) @ frame.T / a
            )
            for each in ka
        ]
    ).T
    frequency_hz = ka / a * C_M_S / (2 * np.pi)
    where = {"axis": axis, "at": vertex, "emitter": EMITTER, "mics": mics}
    found = heard(dish, frequency_hz, rim_strength=0.0, **where) * a
    for one, other in zip(found, optics, strict=True):
        match = abs(np.vdot(one, other)) / np.linalg.norm(one) / np.linalg.norm(other)
        assert match > least
    assert 20 * np.log10(np.linalg.norm(found) / np.linalg.norm(optics)) == pytest.approx(
        0, abs=2.3
    )


def traced(away, aim, radius, bounces):
    """Way of a ray inside a circle from (0, away) back past it, and by how much it misses."""
    at, heading, way = np.array([0.0, away]), np.array([np.sin(aim), -np.cos(aim)]), 0.0
    for _ in range(bounces):
        ahead = -(at @ heading)
        step = ahead + np.sqrt(radius**2 - at @ at + ahead**2)
        at, way = at + step * heading, way + step
        heading = heading - 2 * (heading @ at) * at / radius**2
    back = np.array([0.0, away]) - at
    return way + back @ heading, heading[0] * back[1] - heading[1] * back[0]


@pytest.mark.parametrize(("circle", "bounces"), [(RING_2, 2), (RING_3, 3)])
def test_near_a_dish_a_ring_is_as_late_as_the_ray_that_comes_back(circle, bounces):
    away, radius = 6.0, Dish(1.0, 0.6).sphere_radius_m
    up = np.array([0.0, 0.0, 1.0])
    laid = glints(1.0, 0.6, up, up * away, away * up[None])
    far_aim = ring(radius, bounces)[0] / away
    aim = brentq(lambda aim: traced(away, aim, radius, bounces)[1], 0.9 * far_aim, 1.01 * far_aim)
    way = traced(away, aim, radius, bounces)[0]
    assert laid.centre_path_m[0] + laid.path_m[circle, 0] == pytest.approx(way, abs=1e-6)
    bent = ring(radius, bounces)[0] ** 2 / away
    assert laid.path_m[circle, 0] - ring(radius, bounces)[1] == pytest.approx(bent, rel=0.15)


def test_a_point_of_the_rim_is_heard_when_it_is_passed():
    """Near and far edge of a dish on its side are 2 a sin(tilt) apart in range."""
    dish = Dish.landmark(70)
    laid = laid_for(dish, turned(60))
    half = dish.aperture_radius_m * np.sin(np.deg2rad(60))
    assert laid.reach_m[RIM, 0] == pytest.approx(2 * half, rel=1e-3)


def test_the_rim_can_be_tapered_away():
    dish, where = Dish.landmark(48), {"axis": turned(85)}
    sharp = heard(dish, 50e3, rim_strength=1.0, **where)[0, 0]
    half = heard(dish, 50e3, rim_strength=0.5, **where)[0, 0]
    none = heard(dish, 50e3, rim_strength=0.0, **where)[0, 0]
    assert half == pytest.approx((sharp + none) / 2, rel=1e-3)
    assert abs(none) != pytest.approx(abs(sharp), rel=0.05)


def test_a_rim_seen_edge_on_diffracts_as_a_half_plane():
    """Frontal: every point alike, incidence 28 degrees off the wall: -(1 + 1 / cos 152) / 2."""
    alpha = Dish.landmark(48).half_opening_rad
    orders = rim_orders(alpha, np.array([0.0]))[0]
    keller = -(1 + 1 / np.cos(np.pi / 2 + alpha)) / 2
    kirchhoff = -np.sin(np.pi / 2 + alpha) / (2 * np.cos(np.pi / 2 + alpha))
    np.testing.assert_allclose(orders, [keller - kirchhoff, 0, 0], atol=1e-9)


@radii
def test_a_dish_seen_from_behind_is_a_convex_cap(radius_mm):
    """A mirror of scattering length R/2, as early as its vertex is near, and its rim."""
    dish = Dish.landmark(radius_mm)
    frequency_hz = np.arange(20e3, 80e3, 500.0)
    pressure = heard(dish, frequency_hz, axis=-TOWARD_SONAR, rim_strength=0.0)[0] * FAR_M**2
    k = 2 * np.pi * frequency_hz / C_M_S
    np.testing.assert_allclose(
        pressure * np.exp(-2j * k * FAR_M), dish.sphere_radius_m / 2, rtol=0.01
    )
    assert level_db(dish, 180) < level_db(dish, 0) - 12


def test_a_bowl_of_any_depth_is_heard():
    """Shallow ones without rings are weaker; between tabled depths strengths are between."""
    levels = [level_db(Dish(0.05, 0.05 * ratio), 0.0) for ratio in (0.2, 0.3, 0.6, 0.7, 1.0)]
    assert levels[0] < levels[2] - 3
    assert all(-10 < level < 25 for level in levels)


def test_microphones_of_one_array_hear_one_dish_differently():
    pressure = heard(
        Dish.landmark(70), 60e3, axis=turned(10), at=(1.5, 0, 0), emitter=EMITTER, mics=MICS
    )
    level = 20 * np.log10(np.abs(pressure[:, 0]))
    assert np.ptp(level) > 3.0
