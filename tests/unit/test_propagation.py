from dataclasses import dataclass

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.piston import piston_pattern
from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.band import Band
from ertis_simulator.echoes import Echoes
from ertis_simulator.landmark import Dish, dish_echoes
from ertis_simulator.propagation import render
from ertis_simulator.sensor_response import shipped_response
from ertis_simulator.transducer import AMPLITUDE_AT_1M

RATE_HZ, NUM_SAMPLES = 450e3, 16_384
AIR = Air(20.0, 50.0)
CHIRP = DEFAULT_CHIRP.samples(RATE_HZ)
IDEAL = np.ones(32, np.complex64)
MICS, EMITTER = mic_positions_m(), np.array(EMITTER_POSITION_M)


def paths_m(point):
    point = np.asarray(point, float)
    return np.linalg.norm(point - EMITTER) + np.linalg.norm(point - MICS, axis=1)


def rendered(echoes, air=AIR, mics=IDEAL):
    return render(echoes, air, CHIRP, NUM_SAMPLES, mics)


def exact(path_m, gain, exponent=0.0, sin_emission=0.0, roughness_m=0.0, air=AIR, chirp=CHIRP):
    """One echo computed frequency by frequency, in float64, with room against wrap-around."""
    sensor = shipped_response()
    size = 1 << 16
    frequency_hz = np.fft.rfftfreq(size, 1 / RATE_HZ)[1:-1]
    k = 2 * np.pi * frequency_hz / air.speed_of_sound_m_s
    spectrum = np.fft.rfft(chirp, size)[1:-1] * sensor.amplitude(frequency_hz) * AMPLITUDE_AT_1M
    spectrum = spectrum * k**exponent * piston_pattern(k, np.array(sin_emission))
    spectrum *= np.exp(-2 * (k * roughness_m) ** 2)
    spectrum *= 10 ** (-air.absorption_db_m(frequency_hz) * path_m.mean() / 20)
    delayed = spectrum * np.exp(-1j * k * path_m[:, None]) * gain[:, None]
    return np.fft.irfft(np.pad(delayed, ((0, 0), (1, 1))), size, axis=1)[:, :NUM_SAMPLES]


def in_band(audio, low_hz=20e3, high_hz=90e3):
    frequency_hz = np.fft.rfftfreq(32_768, 1 / RATE_HZ)
    inside = (frequency_hz >= low_hz) & (frequency_hz <= high_hz)
    return np.fft.rfft(audio, 32_768, axis=1)[:, inside]


def error_db(heard, expected):
    off, all_of_it = in_band(heard) - in_band(expected), in_band(expected)
    return 10 * np.log10(np.sum(np.abs(off) ** 2) / np.sum(np.abs(all_of_it) ** 2))


@pytest.mark.parametrize(
    ("point", "spectrum"),
    [
        ((0.6, 0.0, 0.0), {}),
        ((1.0, 0.1, 0.0), {}),
        ((2.5, -0.5, 0.2), {}),
        ((4.0, 0.0, 0.0), {}),
        ((6.0, 0.5, 0.1), {}),
        ((2.5, 0.3, 0.1), {"exponent": 0.5}),
        ((2.5, 0.3, 0.1), {"exponent": 1.0}),
        ((2.5, 0.3, 0.1), {"exponent": -0.5}),
        ((2.5, 0.3, 0.1), {"sin_emission": 0.1}),
        ((2.5, 0.5, 0.1), {"sin_emission": 0.2}),
        ((2.5, 0.8, 0.1), {"sin_emission": 0.3}),
        ((2.5, 1.0, 0.1), {"sin_emission": 0.4}),
        ((2.5, 1.7, 0.1), {"sin_emission": 0.57}),
        ((2.5, 0.3, 0.1), {"roughness_m": 0.5e-3}),
        ((2.5, 0.3, 0.1), {"roughness_m": 1.0e-3}),
    ],
)
def test_one_echo_arrives_when_and_as_strong_as_it_should(point, spectrum):
    path_m = paths_m(point)
    heard = rendered(Echoes.of(path_m, 1 / path_m, **spectrum))
    assert error_db(heard, exact(path_m, 1 / path_m, **spectrum)) <= -50.0


@pytest.mark.parametrize(
    ("chirp", "decimation"),
    [
        (Chirp("hyperbolic", 50e3, 25e3), 6),
        (Chirp("linear", 41e3, 39e3, 10e-3), 8),
        (Chirp("hyperbolic", 80e3, 20e3), 4),
        (Chirp("linear", 110e3, 15e3, 1e-3, 0.0), 3),
    ],
)
def test_trains_are_as_fast_as_a_chirp_is_wide_and_lose_nothing_of_it(chirp, decimation):
    samples, path_m = chirp.samples(RATE_HZ), paths_m((2.5, 0.3, 0.1))
    assert Band.of(samples, NUM_SAMPLES, shipped_response()).decimation == decimation
    echo = Echoes.of(path_m, 1 / path_m, sin_emission=0.2)
    heard = render(echo, AIR, samples, NUM_SAMPLES, IDEAL)
    expected = exact(path_m, 1 / path_m, sin_emission=0.2, chirp=samples)
    assert error_db(heard, expected) <= -50.0


@pytest.mark.parametrize("path_m", [0.001, 0.012, 0.0206, 0.05])
def test_an_echo_from_right_beside_the_microphones_is_heard(path_m):
    """The emitter's rim is 20 mm from the nearest one: its sound rings before the frame begins."""
    path_m = np.full(32, path_m)
    heard = rendered(Echoes.of(path_m, 1 / path_m))
    assert error_db(heard, exact(path_m, 1 / path_m)) <= -40.0


def test_echoes_add_up():
    near, far = paths_m((1.0, 0.2, 0.0)), paths_m((3.0, -0.4, 0.1))
    one, other = Echoes.of(near, 1 / near), Echoes.of(far, -1 / far, exponent=0.5)
    together = rendered(Echoes.join([one, other]))
    np.testing.assert_allclose(together, rendered(one) + rendered(other), atol=1e-6)


def test_each_microphone_has_its_own_gain_and_phase():
    path_m = np.full(32, 3.0)
    mics = np.exp(1j * np.linspace(0, 1, 32)).astype(np.complex64) * np.linspace(1, 2, 32)
    heard = in_band(rendered(Echoes.of(path_m, 1 / path_m), mics=mics.astype(np.complex64)))
    ratio = np.sum(heard * np.conj(heard[:1]), axis=1) / np.sum(np.abs(heard[0]) ** 2)
    np.testing.assert_allclose(ratio, mics, rtol=1e-3)


def test_absorption_takes_more_of_the_high_frequencies_with_range():
    near, far = (in_band(rendered(Echoes.of(np.full(32, d), np.ones(32)))) for d in (2.0, 8.0))
    lost_db = 20 * np.log10(np.abs(near[0] / far[0]))
    frequency_hz = np.linspace(20e3, 90e3, lost_db.size)
    for centre_hz in (30e3, 50e3, 70e3):
        around = np.abs(frequency_hz - centre_hz) < 1e3
        expected = 6.0 * AIR.absorption_db_m(np.array(centre_hz))
        assert lost_db[around].mean() == pytest.approx(expected, abs=0.15)


def test_dry_cold_air_is_heard_to_differ():
    path_m = np.full(32, 6.0)
    cold = Air(0.0, 30.0)
    heard = rendered(Echoes.of(path_m, 1 / path_m), cold)
    assert error_db(heard, exact(path_m, 1 / path_m, air=cold)) <= -50.0
    assert error_db(heard, exact(path_m, 1 / path_m)) > -5.0


@pytest.mark.parametrize("path_m", [12.3, 12.6, 13.2, 13.5, 13.9, 14.3, 20.0])
def test_what_comes_after_the_frame_is_not_heard_at_its_beginning(path_m):
    heard = rendered(Echoes.of(np.full(32, path_m), np.full(32, 1 / path_m)))
    strongest = np.abs(rendered(Echoes.of(np.full(32, 11.0), np.full(32, 1 / 11.0)))).max()
    assert np.abs(heard[:, :8192]).max() < 10 ** (-60 / 20) * strongest


@pytest.mark.parametrize("duration_s", [1e-3, 6e-3])
def test_longer_chirps_do_not_wrap_around_either(duration_s):
    chirp = Chirp(duration_s=duration_s).samples(RATE_HZ)
    heard = [
        render(Echoes.of(np.full(32, d), np.ones(32)), AIR, chirp, NUM_SAMPLES, IDEAL)
        for d in (12.0, 5.0)
    ]
    assert np.abs(heard[0][:, :8192]).max() < 1e-3 * np.abs(heard[1]).max()


def test_no_echo_is_silence():
    silent = rendered(Echoes.of(np.full(32, 3.0), np.zeros(32)))
    assert silent.shape == (32, NUM_SAMPLES)
    assert silent.dtype == np.float32
    assert not silent.any()


@dataclass
class TwoPoints:
    """A body that is only two point echoes, the second ``late_m`` later."""

    path_m: np.ndarray
    late_m: float
    reach_m: tuple = (0.02, 0.3)

    def spectrum(self, k, from_m=None):
        beyond_m = 0.0 if from_m is None else (self.path_m - from_m)[:, None]
        both = np.exp(-1j * k * beyond_m) * (1 + 0.5 * np.exp(-1j * k * self.late_m))
        return (both / self.path_m[:, None]).astype(np.complex64)


@pytest.mark.parametrize("point", [(0.6, 0.0, 0.0), (2.5, -0.5, 0.2), (5.5, 0.5, 0.1)])
@pytest.mark.parametrize("late_m", [0.0, 0.033, 0.1003])
@pytest.mark.parametrize("way", [(0.0, 0.0), (0.3, 0.0), (0.2, 0.5e-3)])
def test_a_body_is_heard_as_the_points_it_is_made_of(point, late_m, way):
    path_m, (sin_emission, roughness_m) = paths_m(point), way
    body = Echoes.from_body(TwoPoints(path_m, late_m))
    heard = rendered(body.emitted(sin_emission, factor=0.7, roughness_m=roughness_m))
    one, other = Echoes.of(path_m, 1 / path_m), Echoes.of(path_m + late_m, 0.5 / path_m)
    points = Echoes.join([one, other])
    # Absorption is taken at the body's own range: its parts differ by less than can be heard.
    expected = rendered(points.emitted(sin_emission, factor=0.7, roughness_m=roughness_m))
    assert error_db(heard, expected) <= (-43.0 if late_m < 0.1 else -37.0)


@pytest.mark.parametrize(("radius_mm", "tilt_deg"), [(20, 0), (48, 20), (70, 50), (120, 0)])
def test_a_dish_is_rendered_as_its_spectrum_says(radius_mm, tilt_deg):
    """Frequency by frequency, without train, window or fade."""
    tilt = np.deg2rad(tilt_deg)
    axis, at = np.array([-np.cos(tilt), np.sin(tilt), 0.0]), np.array([2.0, 0.2, 0.1])
    echoes = dish_echoes(Dish.landmark(radius_mm), axis, at, EMITTER, MICS)
    body, size = echoes.responses[0].body, 1 << 15
    frequency_hz = np.fft.rfftfreq(size, 1 / RATE_HZ)[1:-1]
    k = 2 * np.pi * frequency_hz / AIR.speed_of_sound_m_s
    spectrum = np.fft.rfft(CHIRP, size)[1:-1] * AMPLITUDE_AT_1M
    spectrum = spectrum * shipped_response().amplitude(frequency_hz)
    spectrum = spectrum * 10 ** (-AIR.absorption_db_m(frequency_hz) * body.path_m.mean() / 20)
    delayed = spectrum * body.spectrum(k) * np.exp(-1j * k * body.path_m[:, None])
    expected = np.fft.irfft(np.pad(delayed, ((0, 0), (1, 1))), size, axis=1)[:, :NUM_SAMPLES]
    assert error_db(rendered(echoes), expected) <= -40.0


def test_a_body_behind_the_frame_is_not_heard():
    far = Echoes.from_body(TwoPoints(np.full(32, 12.6), 0.1))
    assert not rendered(far).any()


def test_bodies_keep_their_place_when_echoes_are_joined():
    path_m = paths_m((2.0, 0.1, 0.0))
    body, point = Echoes.from_body(TwoPoints(path_m, 0.05)), Echoes.of(path_m + 0.4, 1 / path_m)
    together = rendered(Echoes.join([point, body]))
    np.testing.assert_allclose(together, rendered(body) + rendered(point), atol=1e-6)
