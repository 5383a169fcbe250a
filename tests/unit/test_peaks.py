import numpy as np
import pytest
import scipy.fft

from ertis_detector.deconvolution import Deconvolution
from ertis_detector.dish_pattern import DishPattern
from ertis_detector.peak_finding import MAX_PEAKS, Peaks, find_peaks
from ertis_detector.peak_likelihood import PatternLikelihood, PeakStatistics
from ertis_detector.peaks import FRAGMENT_SAMPLES, PeakPattern
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, Chirp
from ertis_simulator.landmark import Dish, dish_echoes

RATE_HZ = 450_000.0
C_M_S = 343.2
RADII_MM = (35, 48, 58, 70)
RADII_M = [radius / 1000 for radius in RADII_MM]
BAT = Chirp("linear", 180e3, 30e3, 1e-3)
FAR_M = 200.0
EXPECTED = DishPattern.of(np.array(RADII_M), np.deg2rad([0.0]), 80e3, C_M_S)


def echo(chirp, frequency_response, late_s, rng, noise_db=-30.0):
    """A fragment and a chirp's length more; the vertex answers ``late_s`` off its middle."""
    samples = chirp.samples(RATE_HZ)
    num = FRAGMENT_SAMPLES + samples.size
    size = scipy.fft.next_fast_len(4 * num, real=True)
    frequency_hz = scipy.fft.rfftfreq(size, 1 / RATE_HZ)
    at_s = FRAGMENT_SAMPLES / 2 / RATE_HZ + late_s
    spectrum = scipy.fft.rfft(samples, size) * frequency_response(frequency_hz)
    heard = scipy.fft.irfft(spectrum * np.exp(-2j * np.pi * frequency_hz * at_s), size)[:num]
    noise = rng.normal(size=num) * np.sqrt(np.mean(heard**2)) * 10 ** (noise_db / 20)
    return heard + noise


def glint_response(radius, rng):
    """Four glints where and as strong as the closed form has them, of any phase."""
    amplitude = 10 ** (EXPECTED.level_db[radius, 0] / 20)
    amplitude = amplitude * np.exp(1j * rng.uniform(0, 2 * np.pi, amplitude.size))
    delay_s = EXPECTED.delay_s[radius, 0]
    return lambda f: np.exp(-2j * np.pi * np.outer(f, delay_s)) @ amplitude


def dish_response(radius_mm, tilt_deg):
    """The simulator's dish, fitted to exact scattering, far away."""
    tilt = np.deg2rad(tilt_deg)
    axis = np.array([-np.cos(tilt), np.sin(tilt), 0.0])
    at = np.array([FAR_M, 0.0, 0.0])
    echoes = dish_echoes(Dish.landmark(radius_mm), axis, at, np.zeros(3), np.zeros((1, 3)))
    body = echoes.responses[0].body

    def response(frequency_hz):
        k = 2 * np.pi * frequency_hz / C_M_S
        way = np.exp(-1j * k * (body.path_m[0] - 2 * FAR_M))
        return FAR_M**2 * body.spectrum(k)[0] * way

    return response


# The pattern alone must tell: neither range nor level is known well.
UNTOLD = PeakStatistics(range_std_m=0.05, gain_spread_db=10.0)


def confusion(chirp, response_of, pings=8, seed=0):
    """Size said, over true size; the told range is off by some centimetres."""
    rng = np.random.default_rng(seed)
    pattern = PeakPattern(RADII_M, chirp.samples(RATE_HZ), chirp.band_hz, statistics=UNTOLD)
    said = np.zeros((4, 4), int)
    for radius in range(4):
        late_s = rng.normal(0, 2 * 0.03 / C_M_S, pings)
        heard = np.stack([echo(chirp, response_of(radius, rng), one, rng) for one in late_s])
        probabilities = pattern.probabilities(heard, np.ones(pings))
        np.testing.assert_allclose(probabilities.sum(axis=1), 1)
        np.add.at(said, (radius, probabilities[:, :4].argmax(axis=1)), 1)
    return said


def share_right(said):
    return np.trace(said) / said.sum()


def test_a_division_by_the_chirp_turns_an_echo_into_one_peak_of_its_strength_where_it_begins():
    rng = np.random.default_rng(3)
    samples = DEFAULT_CHIRP.samples(RATE_HZ)
    division = Deconvolution(samples, FRAGMENT_SAMPLES + samples.size, DEFAULT_CHIRP.band_hz)
    heard = echo(DEFAULT_CHIRP, lambda f: np.full(f.size, 0.25), 40.3 / RATE_HZ, rng, -60.0)
    envelope = np.abs(division(heard[None], 1e-3)[0])
    assert envelope.argmax() == FRAGMENT_SAMPLES // 2 + 40
    assert envelope.max() == pytest.approx(0.25, rel=0.02)
    away = np.abs(np.arange(envelope.size) - envelope.argmax()) > 60
    assert envelope[away].max() < 0.25 * 10 ** (-38 / 20)


def test_a_known_sensor_is_divided_out():
    rng = np.random.default_rng(4)
    samples = DEFAULT_CHIRP.samples(RATE_HZ)
    table = (np.array([20e3, 50e3, 80e3]), np.array([-20.0, 0.0, -10.0]))
    size = FRAGMENT_SAMPLES + samples.size
    heard = echo(DEFAULT_CHIRP, lambda f: 10 ** (np.interp(f, *table) / 20), 0.0, rng, -60.0)
    told, untold = (
        Deconvolution(samples, size, DEFAULT_CHIRP.band_hz, sensor=sensor)
        for sensor in (table, None)
    )
    assert np.abs(told(heard[None], 1e-3)).max() == pytest.approx(1.0, rel=0.02)
    assert np.abs(untold(heard[None], 1e-3)).max() < 0.8


def test_absorption_on_the_way_there_and_back_is_divided_out():
    samples = DEFAULT_CHIRP.samples(RATE_HZ)
    division = Deconvolution(samples, 4096, DEFAULT_CHIRP.band_hz)
    spectrum = division.spectrum(np.r_[samples, np.zeros(4096 - samples.size)][None])
    lost = 10 ** (-division._air.absorption_db_m(division.frequency_hz) * 2 * 3.0 / 20)
    near = division.impulse_response(spectrum, 0.0)
    far = division.impulse_response(spectrum * lost, 3.0)
    assert np.abs(far[0]).max() == pytest.approx(np.abs(near[0]).max(), rel=1e-6)


def test_closed_form_delays_grow_with_the_radius_as_rays_say():
    # 2.74 and 3.30 us a mm for the rings, the rim two depths before: acoustics of a cap.
    delay_us = EXPECTED.delay_s[0, 0] * 1e6 / 35 * C_M_S / 343
    np.testing.assert_allclose(delay_us, [-3.499, -3.499, 0, 2.737, 3.304], atol=2e-3)
    np.testing.assert_allclose(
        EXPECTED.delay_s[3, 0], 2 * EXPECTED.delay_s[0, 0], rtol=1e-12, atol=1e-15
    )


def test_a_turned_dish_loses_its_rings_but_not_its_vertex():
    tilts = np.deg2rad([0, 20, 40, 55])
    level_db = DishPattern.of(np.array([0.048]), tilts, 50e3, C_M_S).level_db[0]
    assert np.all(np.diff(level_db[:, 3]) < 0)
    assert level_db[3, 3] < level_db[0, 3] - 30
    np.testing.assert_allclose(level_db[:, 2], level_db[0, 2])


def test_peaks_between_samples_are_found_in_time_and_level():
    n = np.arange(400)
    response = np.exp(-(((n - 150.3) / 8) ** 2)) + 0.1 * np.exp(-(((n - 260.7) / 8) ** 2))
    peaks = find_peaks(np.stack([response, response]) + 0j, np.array([1.0, 2.0]), 100)
    np.testing.assert_allclose(peaks.time_s[0, :2] * RATE_HZ, [50.3, 160.7], atol=0.02)
    np.testing.assert_allclose(peaks.level_db[0, :2], [0, -20], atol=0.01)
    np.testing.assert_allclose(peaks.level_db[1, :2], peaks.level_db[0, :2] + 40 * np.log10(2))
    assert np.isnan(peaks.time_s[0, 2:]).all()
    again = Peaks.from_array(peaks.as_array())
    np.testing.assert_array_equal(again.level_db, peaks.level_db)
    with pytest.raises(ValueError, match="as_array"):
        Peaks.from_array(np.zeros((2, MAX_PEAKS)))


def test_a_broadband_call_makes_out_every_size_from_ideal_glints():
    assert share_right(confusion(BAT, glint_response)) >= 0.95


@pytest.mark.parametrize("tilt_deg", [0, 20])
def test_a_broadband_call_makes_out_every_size_of_real_dishes(tilt_deg):
    said = confusion(BAT, lambda radius, rng: dish_response(RADII_MM[radius], tilt_deg), pings=4)
    assert share_right(said) >= 0.9


def test_a_narrow_call_blurs_ideal_glints_into_other_sizes():
    said = confusion(INCUMBENT_CHIRP, glint_response, pings=16)
    assert 0.4 < share_right(said) < 0.92
    assert share_right(confusion(BAT, glint_response, pings=16)) > share_right(said) + 0.08


def test_a_turned_dish_is_told_by_a_broadband_call_and_not_by_a_narrow_one():
    def turned(radius, _rng):
        return dish_response(RADII_MM[radius], 30)

    assert share_right(confusion(BAT, turned, pings=4)) >= 0.9
    assert share_right(confusion(INCUMBENT_CHIRP, turned, pings=4)) <= 0.6


def test_any_list_of_radii_is_told_apart():
    rng = np.random.default_rng(5)
    radii = [0.02, 0.03, 0.035, 0.045, 0.055, 0.07, 0.09]
    pattern = PeakPattern(radii, BAT.samples(RATE_HZ), BAT.band_hz)
    heard = np.stack([echo(BAT, glint_response(one, rng), 0.0, rng) for one in (0, 3)])
    probabilities = pattern.probabilities(heard, np.ones(2))
    assert probabilities.shape == (2, 8)
    assert [radii[one] for one in probabilities.argmax(axis=1)] == [0.035, 0.07]


def test_clutter_alone_is_most_probably_none():
    rng = np.random.default_rng(6)
    pattern = PeakPattern(RADII_M, BAT.samples(RATE_HZ), BAT.band_hz)
    said = pattern.likelihood.statistics
    count = 5
    peaks = Peaks(
        np.pad(
            rng.uniform(-1.1e-3, 1.1e-3, (40, count)),
            ((0, 0), (0, MAX_PEAKS - count)),
            constant_values=np.nan,
        ),
        np.pad(
            rng.normal(said.clutter_level_db, 5.0, (40, count)),
            ((0, 0), (0, MAX_PEAKS - count)),
            constant_values=np.nan,
        ),
        np.full(40, -60.0),
    )
    none = pattern.likelihood.probabilities(peaks)[:, -1]
    assert np.mean(none > 0.5) > 0.9


def test_fragments_are_weighed_alike_alone_and_in_company():
    rng = np.random.default_rng(7)
    pattern = PatternLikelihood(np.array(RADII_M), 50e3, 30e3, C_M_S, PeakStatistics())
    peaks = Peaks(
        rng.uniform(-1e-3, 1e-3, (19, MAX_PEAKS)),
        rng.normal(-35, 6, (19, MAX_PEAKS)),
        np.full(19, -60.0),
    )
    together = pattern.log_ratios(peaks)
    one = Peaks(peaks.time_s[17:18], peaks.level_db[17:18], peaks.threshold_db[17:18])
    np.testing.assert_allclose(together[17:18], pattern.log_ratios(one), rtol=1e-10)


@pytest.mark.parametrize("radii", [[], [0.03, 0.0], [-0.02]])
def test_radii_that_are_none_are_refused(radii):
    with pytest.raises(ValueError, match="expected one or more lengths"):
        PeakPattern(radii, BAT.samples(RATE_HZ), BAT.band_hz)


def test_a_band_that_is_none_and_a_fragment_too_long_or_short_are_refused():
    samples = BAT.samples(RATE_HZ)
    with pytest.raises(ValueError, match="expected 0 < low < high"):
        PeakPattern(RADII_M, samples, (80e3, 20e3))
    pattern = PeakPattern(RADII_M, samples, BAT.band_hz)
    for length in (FRAGMENT_SAMPLES - 1, FRAGMENT_SAMPLES + samples.size + 1):
        with pytest.raises(ValueError, match="at most a chirp after it"):
            pattern.peaks(np.zeros((1, length)), np.ones(1))
    with pytest.raises(ValueError, match="a chirp's length after it"):
        pattern.deconvolution.spectrum(np.zeros((1, 7)))
