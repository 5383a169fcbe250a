from itertools import pairwise

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.features import BAND_HZ, NUM_BINS, NUM_FEATURES, features, spectral_bins
from ertis_detector.fragment import FRAGMENT_SAMPLES, hann, taper
from ertis_detector.imaging import AUDIO_RATE_HZ, RATE_HZ
from ertis_detector.piston import piston_pattern

CARRIER_HZ = 55e3
BIN_HZ = (BAND_HZ[1] - BAND_HZ[0]) / NUM_BINS
WIDTH = RATE_HZ / FRAGMENT_SAMPLES


def noise(seed, count=3, num_samples=FRAGMENT_SAMPLES):
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((2, count, num_samples))
    return (parts[0] + 1j * parts[1]).astype(np.complex64)


def tone(frequency_hz, num_samples=FRAGMENT_SAMPLES):
    time_s = np.arange(num_samples) / RATE_HZ
    return np.exp(2j * np.pi * (frequency_hz - CARRIER_HZ) * time_s).astype(np.complex64)[None]


def test_a_fragment_has_twenty_bins_and_a_feature_for_each_pair_of_them():
    bins = spectral_bins(noise(1), CARRIER_HZ)
    assert bins.shape == (3, 20)
    found = features(noise(1), CARRIER_HZ, np.full(3, 1.5), np.zeros(3), np.zeros(3))
    assert found.shape == (3, NUM_FEATURES) == (3, 230)
    assert found.dtype == np.float32
    pairs = [a * b for i, a in enumerate(found[0, :20]) for b in found[0, i:20]]
    np.testing.assert_allclose(found[0, 20:], pairs, rtol=1e-5)


@pytest.mark.parametrize("factor", [1e-3, 0.5, 300.0])
def test_loudness_lifts_all_bins_alike(factor):
    lift = spectral_bins(np.complex64(factor) * noise(2), CARRIER_HZ)
    lift -= spectral_bins(noise(2), CARRIER_HZ)
    np.testing.assert_allclose(lift, 20 * np.log10(factor), atol=1e-3)


def corrected(range_m, azimuth_rad, elevation_rad):
    """The first twenty features of one quiet fragment, against those from 1 m ahead."""
    fragment = np.complex64(0.01) * noise(7, 1)
    one, none = np.ones(1), np.zeros(1)
    there = features(fragment, CARRIER_HZ, range_m * one, azimuth_rad * one, elevation_rad * one)
    return 10 * (there - features(fragment, CARRIER_HZ, one, none, none))[0, :20]


def test_spreading_and_absorption_are_made_good():
    centres_hz = BAND_HZ[0] + BIN_HZ * (np.arange(NUM_BINS) + 0.5)
    expected = 40 * np.log10(2.5) + 2 * 1.5 * Air(20.0, 50.0).absorption_db_m(centres_hz)
    np.testing.assert_allclose(corrected(2.5, 0.0, 0.0), expected, atol=1e-3)


@pytest.mark.parametrize(("azimuth_rad", "elevation_rad"), [(0.14, 0.0), (0.0, 0.14), (-0.1, 0.1)])
def test_the_emitters_beam_pattern_is_made_good(azimuth_rad, elevation_rad):
    centres_hz = BAND_HZ[0] + BIN_HZ * (np.arange(NUM_BINS) + 0.5)
    sine = np.sqrt(1 - (np.cos(azimuth_rad) * np.cos(elevation_rad)) ** 2)
    k = 2 * np.pi * centres_hz / Air(20.0).speed_of_sound_m_s
    expected = -20 * np.log10(piston_pattern(k, np.array(sine)))
    np.testing.assert_allclose(corrected(1.0, azimuth_rad, elevation_rad), expected, atol=1e-2)


def test_phase_does_not_change_the_features():
    turned = noise(3) * np.complex64(np.exp(1.2j))
    np.testing.assert_allclose(
        spectral_bins(turned, CARRIER_HZ), spectral_bins(noise(3), CARRIER_HZ), atol=1e-3
    )


@pytest.mark.parametrize("number", range(NUM_BINS))
@pytest.mark.parametrize("part", [0.2, 0.5, 0.8])
def test_a_tone_falls_into_its_own_bin(number, part):
    bins = spectral_bins(tone(BAND_HZ[0] + (number + part) * BIN_HZ), CARRIER_HZ)[0]
    assert bins.argmax() == number
    others = np.delete(bins, number)
    assert bins[number] - others.max() > 6.0


def test_a_tone_outside_the_band_moves_no_bin_much():
    both = noise(4, 1) + 0 * tone(15e3)
    assert spectral_bins(both, CARRIER_HZ)[0].std() < 3.0
    loud = noise(4, 1) + np.complex64(3.0) * tone(15e3)
    np.testing.assert_allclose(
        spectral_bins(loud, CARRIER_HZ), spectral_bins(both, CARRIER_HZ), atol=0.2
    )


def test_each_feature_is_the_mean_magnitude_of_its_bin_in_decibels():
    fragment = noise(5, 1)
    spectrum = np.abs(np.fft.fft(fragment[0] * np.hanning(FRAGMENT_SAMPLES)))
    frequency = CARRIER_HZ + np.fft.fftfreq(FRAGMENT_SAMPLES, 1 / RATE_HZ)
    edges = np.linspace(*BAND_HZ, NUM_BINS + 1)
    expected = []
    for low, high in pairwise(edges):
        inside = (frequency >= low - WIDTH / 2) & (frequency < high - WIDTH / 2)
        mean = spectrum[inside].mean() * AUDIO_RATE_HZ / RATE_HZ
        expected.append(20 * np.log10(mean))
    np.testing.assert_allclose(spectral_bins(fragment, CARRIER_HZ)[0], expected, atol=0.01)


def test_each_row_is_judged_alone():
    rows = noise(6, 4)
    together = spectral_bins(rows, CARRIER_HZ)
    for row, bins in zip(rows, together, strict=True):
        np.testing.assert_allclose(spectral_bins(row[None], CARRIER_HZ)[0], bins, atol=1e-4)


def test_what_lies_50_db_under_the_strongest_bin_is_cut_off():
    bins = spectral_bins(tone(65e3), CARRIER_HZ)[0]
    assert bins.max() - bins.min() == pytest.approx(50.0, abs=1e-3)


def test_silence_has_finite_features():
    silent = spectral_bins(np.zeros((2, FRAGMENT_SAMPLES), np.complex64), CARRIER_HZ)
    assert np.isfinite(silent).all()


def test_the_taper_silences_both_ends_and_leaves_the_middle():
    window = hann(FRAGMENT_SAMPLES)
    tapered = taper(np.ones((1, FRAGMENT_SAMPLES), np.complex64))[0]
    np.testing.assert_array_equal(tapered.real, window)
    assert window[0] == window[-1] == 0.0
    assert window[190:194].min() > 0.9998
