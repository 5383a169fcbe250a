"""What the classifier sees: measured against echoes whose reflectivity is known."""

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.features import (
    NUM_BINS,
    NUM_FEATURES,
    NUM_SCALARS,
    EchoFeatures,
    Places,
    array_coherence,
)
from ertis_detector.fragment import FRAGMENT_SAMPLES, gate
from ertis_detector.imaging import AUDIO_RATE_HZ, RATE_HZ, Focus, MatchedFilter
from ertis_detector.piston import piston_pattern
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m

CHIRP = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
AIR = Air(20.0)
LEVEL, RANGE, SHIFT = 0, 2, 6  # among the scalars
SPECTRUM = slice(NUM_SCALARS, NUM_SCALARS + NUM_BINS)
ENVELOPE = slice(SPECTRUM.stop, SPECTRUM.stop + 59)
CORRELATION = slice(ENVELOPE.stop, ENVELOPE.stop + 33)
MIDDLE, STEP_S = 32, 8e-6


@pytest.fixture(scope="module")
def matched():
    return MatchedFilter(CHIRP, 16_384, (20e3, 80e3))


@pytest.fixture(scope="module")
def made(matched):
    return EchoFeatures(matched, CHIRP, AIR)


def places(range_m=1.0, azimuth_rad=0.0, elevation_rad=0.0, count=1, snr_db=30.0):
    full = [np.full(count, value) for value in (range_m, azimuth_rad, elevation_rad, snr_db)]
    return Places(*full)


def heard(matched, *glints, start=8000):
    """The fragment of point reflectors, (delay in s, strength) each; flat, as far as the chirp."""
    spectrum = np.fft.rfft(CHIRP, 32_768)
    frequency = np.fft.rfftfreq(32_768, 1 / AUDIO_RATE_HZ)
    total = sum(
        strength * np.exp(-2j * np.pi * frequency * (start / AUDIO_RATE_HZ + delay))
        for delay, strength in glints
    )
    audio = np.fft.irfft(spectrum * total, 32_768)[:16_384].astype(np.float32)
    baseband = matched(audio[None])[0]
    first = round(start * RATE_HZ / AUDIO_RATE_HZ) - FRAGMENT_SAMPLES // 2
    return baseband[None, first : first + FRAGMENT_SAMPLES].copy()


def see(made, fragments, where=None):
    coherence = np.ones((len(fragments), 7))
    return made(fragments, coherence, where or places(count=len(fragments)))


def test_a_row_has_a_number_for_every_feature(matched, made):
    found = see(made, heard(matched, (0.0, 1.0)))
    assert found.shape == (1, NUM_FEATURES) == (1, 138)
    assert found.dtype == np.float32


@pytest.mark.parametrize("delay_us", [96, 160])
def test_two_glints_stand_in_the_envelope_and_the_autocorrelation_at_their_delay(
    matched, made, delay_us
):
    found = see(made, heard(matched, (-delay_us * 1e-6, 0.6), (0.0, 1.0)))[0]
    envelope, correlation = found[ENVELOPE], found[CORRELATION]
    early = MIDDLE - delay_us // 8
    assert envelope[MIDDLE] == pytest.approx(0.1, abs=0.3)
    around = envelope[early - 5 : early + 6]
    assert around.argmax() == pytest.approx(5, abs=1)
    assert envelope[early] == pytest.approx(20 * np.log10(0.6), abs=3.0)
    assert correlation[6:].argmax() + 6 == pytest.approx(delay_us // 8 - 1, abs=1)


def test_the_envelope_is_aligned_to_the_peak_wherever_it_was_located(matched, made):
    late = see(made, heard(matched, (24e-6, 1.0)))[0]
    exact = see(made, heard(matched, (0.0, 1.0)))[0]
    assert late[SHIFT] - exact[SHIFT] == pytest.approx(3, abs=1)
    np.testing.assert_allclose(late[ENVELOPE][24:41], exact[ENVELOPE][24:41], atol=4.0)


@pytest.mark.parametrize("factor", [0.1, 0.5, 30.0])
def test_loudness_moves_the_levels_and_nothing_else(matched, made, factor):
    fragment = heard(matched, (-1e-4, 0.5), (0.0, 1.0))
    louder = see(made, np.complex64(factor) * fragment)[0] - see(made, fragment)[0]
    assert louder[LEVEL] == pytest.approx(20 * np.log10(factor), abs=1e-2)
    np.testing.assert_allclose(louder[NUM_SCALARS:], 0.0, atol=2e-2)


def test_phase_changes_nothing(matched, made):
    fragment = heard(matched, (-1e-4, 0.5), (0.0, 1.0))
    turned = fragment * np.complex64(np.exp(1.2j))
    np.testing.assert_allclose(see(made, turned), see(made, fragment), atol=1e-2)


def test_spreading_is_made_good_so_that_the_level_is_the_reflectors(matched, made):
    fragment = heard(matched, (0.0, 1.0))
    near = made.reflectivity(fragment, places(1.0))
    far = made.reflectivity(fragment, places(2.0))
    ratio_db = 20 * np.log10(np.abs(far / near))[0]
    expected = 2 * 20 * np.log10(2.0) + 2 * AIR.absorption_db_m(made.frequency_hz)
    # Where absorption and transducer leave too little, nothing is lifted further.
    reached = slice(8, 50)
    np.testing.assert_allclose(ratio_db[reached], expected[reached], atol=0.01)


def test_absorption_is_that_of_the_air_it_was_heard_in(matched):
    cold = EchoFeatures(matched, CHIRP, Air(-5.0))
    warm = EchoFeatures(matched, CHIRP, Air(35.0))
    fragment = heard(matched, (0.0, 1.0))
    lifts = [
        np.abs(made.reflectivity(fragment, places(2.0)) / made.reflectivity(fragment, places(1.0)))
        for made in (cold, warm)
    ]
    middle = lifts[0].shape[1] // 2
    expected = [
        4 * 10 ** (2 * Air(t).absorption_db_m(cold.frequency_hz[middle]) / 20) for t in (-5.0, 35.0)
    ]
    assert [lift[0, middle] for lift in lifts] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("azimuth_rad", "elevation_rad"), [(0.14, 0.0), (0.0, 0.14), (-0.1, 0.1)])
def test_the_emitters_beam_pattern_is_made_good(matched, made, azimuth_rad, elevation_rad):
    fragment = heard(matched, (0.0, 1.0))
    aside = made.reflectivity(fragment, places(1.0, azimuth_rad, elevation_rad))
    ahead = made.reflectivity(fragment, places(1.0))
    sine = np.sqrt(1 - (np.cos(azimuth_rad) * np.cos(elevation_rad)) ** 2)
    k = 2 * np.pi * made.frequency_hz / AIR.speed_of_sound_m_s
    lift = np.abs(aside / ahead)[0]
    reached = slice(8, 50)
    np.testing.assert_allclose(
        lift[reached], 1 / piston_pattern(k, np.array(sine))[reached], rtol=1e-3
    )


def test_a_flat_reflector_has_a_smooth_spectrum_and_two_make_it_ripple(matched, made):
    one = see(made, heard(matched, (0.0, 1.0)))[0, SPECTRUM]
    two = see(made, heard(matched, (-1.5e-4, 1.0), (0.0, 1.0)))[0, SPECTRUM]
    assert np.abs(np.diff(one)[4:-4]).max() < 4.0
    assert np.ptp(two - one) > 10.0


def test_each_row_is_judged_alone(matched, made):
    rows = np.concatenate([heard(matched, (0.0, 1.0)), heard(matched, (-1e-4, 1.0), (0.0, 0.3))])
    together = see(made, rows)
    for row, found in zip(rows, together, strict=True):
        np.testing.assert_allclose(see(made, row[None])[0], found, atol=1e-2)


def test_silence_has_finite_features(made):
    assert np.isfinite(see(made, np.zeros((2, FRAGMENT_SAMPLES), np.complex64))).all()


def test_what_lies_outside_the_gate_is_not_seen(matched, made):
    alone = see(made, heard(matched, (0.0, 1.0)))
    beside = see(made, heard(matched, (0.0, 1.0), (5.4e-4, 1.0)))
    np.testing.assert_allclose(beside[0, NUM_SCALARS:], alone[0, NUM_SCALARS:], atol=1.5)


def test_the_gate_leaves_the_middle_and_silences_both_ends():
    window = gate()
    assert window[0] == window[-1] == 0.0
    assert window[50:130].min() == 1.0


def test_a_chirp_of_another_band_has_as_many_features():
    chirp = INCUMBENT_CHIRP.samples(AUDIO_RATE_HZ)
    matched = MatchedFilter(chirp, 16_384, (25e3, 50e3))
    found = see(EchoFeatures(matched, chirp, AIR), np.ones((3, FRAGMENT_SAMPLES), np.complex64))
    assert found.shape == (3, NUM_FEATURES)


def array_sound(matched, focus, *points):
    """Compressed sound of the 32 microphones, from point reflectors of equal strength."""
    spectrum = np.fft.rfft(CHIRP, 32_768)
    frequency = np.fft.rfftfreq(32_768, 1 / AUDIO_RATE_HZ)
    late_s = sum(
        np.exp(-2j * np.pi * frequency * focus.delays_s(np.array([point]))[0][:, None])
        for point in points
    )
    audio = np.fft.irfft(spectrum * late_s, 32_768, axis=1)[:, :16_384].astype(np.float32)
    return matched(audio).copy()


def test_one_reflector_is_coherent_and_a_cluster_is_less_so_the_higher_the_frequency(matched):
    focus = Focus(mic_positions_m(), np.array(EMITTER_POSITION_M), matched.baseband, 343.0)
    place = np.array([2.0, 0.1, 0.05])
    aside = np.array([0.0, 0.22, 0.18])  # as far away: its echo comes at the same time
    aside[0] = np.sqrt(place @ place - aside @ aside)
    single = array_coherence(focus, array_sound(matched, focus, place), place[None])[0]
    assert single.min() > 0.95
    cluster = array_coherence(focus, array_sound(matched, focus, place, aside), place[None])[0]
    assert cluster.mean() < 0.8
    noise = np.random.default_rng(1).standard_normal((32, 16_384)).astype(np.float32)
    assert array_coherence(focus, matched(noise), place[None])[0].mean() < 0.15
