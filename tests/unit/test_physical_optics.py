import numpy as np
import pytest

from ertis_simulator.glints import ring
from ertis_simulator.physical_optics import CapOptics

DEPTH_RATIO = 0.6
# |f| far away over aperture radius, tilt 0, 10 .. 60 degrees: boundary elements for the rigid thin
# screen, converged to 0.06 dB. Nothing here was fitted to them.
EXACT_TILTS_RAD = np.deg2rad(np.arange(0, 61, 10))
EXACT = {
    20.0: (3.793, 3.522, 2.921, 1.822, 0.391, 0.653, 0.314),
    60.0: (8.648, 5.325, 2.762, 1.293, 0.649, 0.319, 0.420),
}


def monostatic(cap, tilt_rad):
    tilt_rad = np.atleast_1d(tilt_rad)
    return cap.far_field(tilt_rad, tilt_rad, np.zeros(tilt_rad.size))


def one_bounce_more(ka, tilt_rad, bounces, depth_ratio=DEPTH_RATIO):
    """What the last of ``bounces`` adds."""
    more, less = (CapOptics(depth_ratio, ka, bounces=n) for n in (bounces, bounces - 1))
    return monostatic(more, tilt_rad) - monostatic(less, tilt_rad)


def test_it_has_converged_at_eight_points_a_wavelength():
    tilt = np.deg2rad([0.0, 15.0, 30.0, 45.0, 60.0])
    usual = monostatic(CapOptics(DEPTH_RATIO, 30.0), tilt)
    finer = monostatic(CapOptics(DEPTH_RATIO, 30.0, points_per_wavelength=14.0), tilt)
    coarse = monostatic(CapOptics(DEPTH_RATIO, 30.0, points_per_wavelength=0.5), tilt)
    assert np.max(np.abs(usual - finer)) < 0.003 * np.max(np.abs(finer))
    assert np.max(np.abs(coarse - finer)) > 0.02 * np.max(np.abs(finer))


def test_after_six_bounces_little_is_left():
    tilt = np.deg2rad([0.0, 10.0, 20.0, 30.0, 40.0])
    six, eight = (monostatic(CapOptics(DEPTH_RATIO, 30.0, bounces=n), tilt) for n in (6, 8))
    two = monostatic(CapOptics(DEPTH_RATIO, 30.0, bounces=2), tilt)
    assert np.linalg.norm(six - eight) < 0.06 * np.linalg.norm(eight)
    assert np.linalg.norm(two - eight) > 0.15 * np.linalg.norm(eight)


@pytest.mark.parametrize("ka", [15.0, 40.0])
def test_source_and_observer_may_nearly_be_swapped(ka):
    """Physical optics is not reciprocal in itself: its mean is taken, and the rest stays small."""
    tilt = np.deg2rad([0.0, 10.0, 20.0, 30.0])
    cap = CapOptics(DEPTH_RATIO, ka)
    asymmetry = cap.asymmetry(tilt, tilt + 0.02, np.full(4, 0.01))
    assert np.sqrt(np.mean(asymmetry**2)) < 0.2
    assert np.all(asymmetry > 0)
    there = cap.far_field(tilt, tilt + 0.05, np.full(4, 0.03))
    np.testing.assert_allclose(cap.far_field(tilt + 0.05, tilt, np.full(4, 0.03)), there, rtol=1e-5)


def test_the_near_field_becomes_the_far_field():
    cap, tilts, away = CapOptics(DEPTH_RATIO, 20.0), np.deg2rad([5.0, 30.0, 50.0]), 3e4
    for tilt in tilts:
        at = away * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
        near = cap.near_field(at, at[None])[0] * away**2 * np.exp(-2j * cap.ka * away)
        assert near == pytest.approx(monostatic(cap, tilt)[0], abs=5e-3)


def test_a_source_off_the_plane_of_symmetry_sounds_the_same_turned_around_the_axis():
    cap = CapOptics(DEPTH_RATIO, 12.0)
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    source, mics = np.array([4.0, 0.0, 15.0]), np.array([[3.0, 1.5, 14.0], [5.0, -1.0, 15.0]])
    straight = cap.near_field(source, mics)
    turned = cap.near_field(turn @ source, mics @ turn.T)
    np.testing.assert_allclose(turned, straight, rtol=5e-3)


@pytest.mark.parametrize("bounces", [2, 3])
def test_each_bounce_comes_as_late_as_rays_say(bounces):
    """From the phase over ka, which turns by the way."""
    ka = np.arange(12.0, 42.0, 0.9)
    f = np.array([one_bounce_more(each, 1e-4, bounces)[0] for each in ka])
    way = np.arange(1.0, 5.0, 0.01)
    envelope = np.abs(np.exp(-1j * np.outer(way, ka)) @ (f * np.hanning(ka.size)))
    expected = ring(CapOptics(DEPTH_RATIO, 1.0).radius, bounces)[1]
    assert way[np.argmax(envelope)] == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize("ka", [30.0, 60.0])
def test_the_two_bounce_ring_is_as_strong_as_rays_say(ka):
    radius = 1.0  # a hemisphere: its edge is far from the ring, so a mean over ka leaves it out
    b, way = ring(radius, 2)
    around = ka + np.arange(-4.0, 4.1, 1.0)
    found = [
        one_bounce_more(each, 1e-4, 2, depth_ratio=1.0)[0] * np.exp(-1j * each * way)
        for each in around
    ]
    expected = b * np.sqrt(2 * np.pi * ka * radius * np.cos(np.pi / 4) / 4)
    assert abs(np.mean(found)) == pytest.approx(expected, rel=0.06)


def test_the_vertex_scatters_as_half_the_sphere_radius_and_lasts_to_60_degrees():
    ka = np.arange(60.0, 80.0, 1.7)
    radius = CapOptics(DEPTH_RATIO, 1.0).radius
    tilt = np.deg2rad([10.0, 30.0, 45.0, 75.0])
    kirchhoff = np.array([monostatic(CapOptics(DEPTH_RATIO, k, bounces=1), tilt) for k in ka])
    vertex = np.mean(kirchhoff * np.exp(-2j * ka * radius)[:, None], axis=0)
    np.testing.assert_allclose(vertex[:3], -radius / 2, atol=0.15)
    assert abs(vertex[3]) < 0.1


def test_the_rings_are_gone_by_45_degrees_and_only_the_edge_is_left_at_80():
    tilt = np.deg2rad([0.0, 20.0, 45.0, 80.0])
    rings = np.array([one_bounce_more(ka, tilt, 2) for ka in (40.0, 43.0, 46.0, 49.0)])
    level_db = 10 * np.log10(np.mean(np.abs(rings) ** 2, axis=0))
    level_db -= level_db[0]
    assert level_db[1] > -8
    assert level_db[2] < -18
    assert level_db[3] < -35


@pytest.mark.parametrize("ka", list(EXACT))
def test_it_agrees_with_the_exact_solution_to_60_degrees(ka):
    exact = np.array(EXACT[ka])
    found = np.abs(monostatic(CapOptics(DEPTH_RATIO, ka), EXACT_TILTS_RAD))
    assert np.corrcoef(found, exact)[0, 1] > 0.99
    assert np.linalg.norm(found - exact) < 0.14 * np.linalg.norm(exact)
    kirchhoff = np.abs(monostatic(CapOptics(DEPTH_RATIO, ka, bounces=1), EXACT_TILTS_RAD))
    assert np.linalg.norm(kirchhoff - exact) > 0.6 * np.linalg.norm(exact)
