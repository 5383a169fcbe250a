"""The exact solutions, against everything that is known without them."""

from __future__ import annotations

import numpy as np
import pytest

from ertis_simulator.reference.disc import kirchhoff_amplitude, rayleigh_amplitude
from ertis_simulator.reference.meridian import CapMeridian, DiscMeridian
from ertis_simulator.reference.screen import Screen
from ertis_simulator.reference.sphere_series import sphere_amplitude, sphere_near_amplitude
from ertis_simulator.reference.table import Views


def scattered_power(amplitude, num_tilts=48, num_azimuths=48):
    """Integral of |f|^2 over all directions; ``amplitude(tilt, azimuth)``."""
    cosine, weights = np.polynomial.legendre.leggauss(num_tilts)
    azimuth = 2 * np.pi * np.arange(num_azimuths) / num_azimuths
    tilt, around = np.meshgrid(np.arccos(cosine), azimuth, indexing="ij")
    intensity = np.abs(amplitude(tilt, around)) ** 2
    return float(weights @ intensity.mean(axis=1) * 2 * np.pi)


def test_a_small_sphere_scatters_backwards_as_rayleigh_says():
    assert abs(sphere_amplitude(0.02, np.pi)) == pytest.approx(5 / 6 * 0.02**2, rel=1e-3)


def test_a_large_sphere_returns_half_its_radius_with_the_phase_of_its_front():
    errors = [abs(sphere_amplitude(ka, np.pi) - 0.5 * np.exp(-2j * ka)) for ka in (100.0, 200.0)]
    assert errors[1] < 0.004
    assert errors[1] == pytest.approx(errors[0] / 2, rel=0.05)  # the next term is of order 1/ka


def test_the_spheres_shadow_carries_the_power_it_scatters():
    def echo(tilt, around):
        return sphere_amplitude(7.0, tilt)

    forward = sphere_amplitude(7.0, 0.0)
    assert scattered_power(echo) == pytest.approx(4 * np.pi / 7.0 * forward.imag, rel=1e-10)


def test_the_spheres_near_field_becomes_its_far_field():
    far = sphere_amplitude(9.0, np.pi - 0.4)
    errors = [abs(sphere_near_amplitude(9.0, r, r, 0.4) - far) for r in (1e3, 1e4)]
    assert errors[1] < 1e-2 * abs(far)
    assert errors[1] == pytest.approx(errors[0] / 10, rel=0.05)


def test_a_small_disc_is_the_dipole_of_the_exact_low_frequency_limit():
    tilt = np.deg2rad([0.0, 40.0, 80.0])
    echo = Screen.build(DiscMeridian(), 0.02).amplitude(tilt, tilt)
    assert echo == pytest.approx(rayleigh_amplitude(0.02, tilt), rel=1e-3)


def test_a_large_disc_nears_kirchhoff_on_its_axis():
    errors = []
    for ka in (10.0, 40.0):
        exact = Screen.build(DiscMeridian(), ka, max_tilt_rad=0.1).amplitude(0.0, 0.0)
        errors.append(abs(exact / kirchhoff_amplitude(ka, 0.0) - 1))
    assert errors[1] < 0.03
    assert errors[1] < errors[0] / 2


def test_a_disc_seen_edge_on_is_invisible():
    assert abs(Screen.build(DiscMeridian(), 10.0).amplitude(np.pi / 2, np.pi / 2)) < 1e-12


@pytest.mark.parametrize("ka", [3.0, 10.0])
def test_a_nearly_closed_shell_scatters_like_the_sphere(ka):
    shell = Screen.build(CapMeridian(1.0, np.deg2rad(179.8)), ka)
    tilt = np.deg2rad([180.0, 160.0, 130.0, 100.0])
    assert shell.amplitude(np.pi, tilt) == pytest.approx(sphere_amplitude(ka, tilt), abs=2e-3)


def test_a_nearly_closed_shell_has_the_spheres_near_field():
    shell = Screen.build(CapMeridian(1.0, np.deg2rad(179.8)), 6.0)
    echo = shell.amplitude(np.pi, np.deg2rad(150.0), source_r=3.0, mic_r=2.0)
    assert echo == pytest.approx(sphere_near_amplitude(6.0, 3.0, 2.0, np.deg2rad(30.0)), abs=2e-3)


def test_the_dish_throws_the_shadow_of_its_aperture():
    """Forward scattering of a large screen is ``i k area / (2 pi)``, from either side."""
    dish = Screen.build(CapMeridian.landmark(), 40.0)
    for source, mic in ((0.0, np.pi), (np.pi, 0.0)):
        assert dish.amplitude(source, mic) == pytest.approx(40j / 2, rel=0.1)


@pytest.mark.parametrize("tilt_deg", [0.0, 35.0])
def test_the_dish_takes_from_the_wave_what_it_scatters(tilt_deg):
    ka, tilt = 9.0, np.deg2rad(tilt_deg)
    dish = Screen.build(CapMeridian.landmark(), ka)
    forward = dish.amplitude(tilt, np.pi - tilt, np.pi)
    power = scattered_power(lambda mic, around: dish.amplitude(tilt, mic, around))
    assert power == pytest.approx(4 * np.pi / ka * forward.imag, rel=1e-5)


def test_source_and_microphone_may_change_places():
    dish = Screen.build(CapMeridian.landmark(), 12.0)
    there = dish.amplitude(0.3, 1.1, 0.7, source_r=5.0, mic_r=np.inf)
    back = dish.amplitude(1.1, 0.3, -0.7, source_r=np.inf, mic_r=5.0)
    assert there == pytest.approx(back, rel=1e-9)


def test_twice_the_dish_at_half_the_wavenumber_is_the_same_dish():
    cap = CapMeridian.landmark()
    double = CapMeridian(2 * cap.sphere_radius, cap.half_opening_rad)
    small = Screen.build(cap, 10.0).amplitude(0.2, 0.3, 0.1, 8.0, 9.0)
    large = Screen.build(double, 5.0).amplitude(0.2, 0.3, 0.1, 16.0, 18.0)
    assert large == pytest.approx(2 * small, rel=1e-9)


def test_a_far_source_is_a_plane_wave():
    dish = Screen.build(CapMeridian.landmark(), 10.0)
    assert dish.amplitude(0.2, 0.3, 0.1, 1e7, 1e7) == pytest.approx(
        dish.amplitude(0.2, 0.3, 0.1), rel=1e-4
    )


def test_more_elements_and_more_modes_change_nothing():
    tilt = np.deg2rad(np.arange(0.0, 91.0, 15.0))
    cap = CapMeridian.landmark()
    usual = Screen.build(cap, 30.0).amplitude(tilt, tilt)
    finer = Screen.build(cap, 30.0, degree=11, panels_per_wavelength=1.6, mode_margin=20)
    exact = finer.amplitude(tilt, tilt)
    assert np.abs(usual - exact).max() < 2e-4 * np.abs(exact).max()
    coarse = Screen.build(cap, 30.0, degree=3).amplitude(tilt, tilt)
    assert np.abs(coarse - exact).max() > 10 * np.abs(usual - exact).max()


def test_on_the_axis_it_does_not_matter_in_which_plane_the_microphone_stands():
    in_plane = Views.of([0.0], 0.1).amplitude(15.0)
    across = Views.of([0.0], 0.1, across=True).amplitude(15.0)
    assert in_plane == pytest.approx(across, rel=1e-9)
