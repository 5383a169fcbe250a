import numpy as np
import pytest

from ertis_driver.audio import PdmDecoder
from ertis_driver.bit_runs import stuck_mics
from ertis_simulator.microphone import (
    GAIN_SPREAD_DB,
    PHASE_SPREAD_RAD,
    MicrophoneSet,
    add_noise,
    corrupt_half_words,
    kill_microphones,
    noise_density_db,
    to_pdm,
)

RATE_HZ, NUM_SAMPLES = 450e3, 16_384
TIME_S = np.arange(NUM_SAMPLES) / RATE_HZ


def decoded(pressure, seed=1):
    words = to_pdm(np.asarray(pressure, np.float32), np.random.default_rng(seed))
    return PdmDecoder().decode(words).audio.astype(np.float64)


def tone(frequency_hz, amplitude):
    phase = np.linspace(0, 6, 32)[:, None]
    return amplitude * np.sin(2 * np.pi * frequency_hz * TIME_S + phase)


def amplitude_at(audio, frequency_hz):
    """Complex amplitude of a tone in the middle of the frame, for each microphone."""
    middle = slice(500, -500)
    window = np.hanning(TIME_S[middle].size)
    turn = np.exp(-2j * np.pi * frequency_hz * TIME_S[middle])
    return 2j * (audio[:, middle] * window * turn).sum(axis=1) / window.sum()


def density_db(rows, rate_hz, low_hz, high_hz):
    """Mean one-sided power density of (n, num_samples) rows between two frequencies, dB per Hz."""
    size = 4096
    whole = rows.shape[1] // size * size
    window = np.hanning(size)
    spectrum = np.fft.rfft(rows[:, :whole].reshape(-1, size) * window, axis=1)
    density = 2 * np.mean(np.abs(spectrum) ** 2, axis=0) / (rate_hz * np.sum(window**2))
    frequency_hz = np.fft.rfftfreq(size, 1 / rate_hz)
    return 10 * np.log10(density[(frequency_hz >= low_hz) & (frequency_hz < high_hz)].mean())


@pytest.fixture(scope="module")
def silence():
    """The words of a microphone that hears only its own noise."""
    rng = np.random.default_rng(2)
    pressure = np.zeros((32, NUM_SAMPLES), np.float32)
    add_noise(pressure, rng)
    return to_pdm(pressure, rng)


@pytest.mark.parametrize("frequency_hz", [25e3, 40e3, 60e3, 80e3])
@pytest.mark.parametrize("level", [0.3, 0.6])
def test_the_pdm_of_a_tone_decodes_to_that_tone(frequency_hz, level):
    found = amplitude_at(decoded(tone(frequency_hz, level)), frequency_hz)
    np.testing.assert_allclose(20 * np.log10(np.abs(found) / level), 0.0, atol=0.12)
    # Half a PDM sample of delay at either end of the chain: 0.2 us, under 0.05 mm of range.
    late_s = (np.linspace(0, 6, 32) - np.angle(found)) / (2 * np.pi * frequency_hz)
    late_s -= np.rint(late_s * frequency_hz) / frequency_hz
    np.testing.assert_allclose(late_s, 0.0, atol=0.3e-6)


def test_a_weak_tone_decodes_as_well_in_the_mean():
    found = amplitude_at(decoded(tone(40e3, 0.01)), 40e3)
    assert 20 * np.log10(np.abs(found).mean() / 0.01) == pytest.approx(0.0, abs=0.12)


@pytest.mark.parametrize("centre_hz", [6e3, 18e3, 35e3, 50e3, 75e3, 95e3, 105e3])
def test_the_noise_in_the_band_is_the_microphones_own(silence, centre_hz):
    audio = PdmDecoder().decode(silence).audio[:, 200:].astype(np.float64)
    found = density_db(audio, RATE_HZ, centre_hz - 2e3, centre_hz + 2e3)
    # The modulator's own noise, -110 dBFS/Hz at 60 to 100 kHz, comes on top.
    assert -1.0 < found - noise_density_db(np.array(centre_hz)) < 4.5


def test_the_noise_added_has_the_density_of_the_table():
    pressure = np.zeros((32, 16_000), np.float32)  # not the size of a transform
    add_noise(pressure, np.random.default_rng(11))
    for centre_hz in np.arange(5e3, 140e3, 15e3):
        expected = noise_density_db(np.linspace(centre_hz - 1e3, centre_hz + 1e3, 9))
        mean_db = 10 * np.log10(np.mean(10 ** (expected / 10)))
        found = density_db(pressure, RATE_HZ, centre_hz - 1e3, centre_hz + 1e3)
        assert found == pytest.approx(mean_db, abs=0.6)


def test_the_pdm_noise_is_shaped_upward_above_120_khz(silence):
    bits = 2.0 * ((silence[:, None] >> np.arange(8, dtype=np.uint32)) & 1).T - 1
    levels = [
        density_db(bits, 4.5e6, f - 5e3, f + 5e3) for f in (60e3, 120e3, 160e3, 250e3, 400e3, 1e6)
    ]
    assert np.all(np.diff(levels)[1:] > 3.0)
    per_decade = (levels[3] - levels[1]) / np.log10(250 / 120)
    assert 65 < per_decade < 85  # 4th order: 80; a real ping: 75
    assert levels[5] - levels[0] > 30


def test_the_microphones_noises_are_independent(silence):
    audio = PdmDecoder().decode(silence).audio[:, 200:]
    likeness = np.corrcoef(audio)
    np.fill_diagonal(likeness, 0.0)
    assert np.abs(likeness).max() < 0.07  # mostly shaped noise: few independent samples


def test_an_overdriven_microphone_recovers_within_a_tenth_of_a_millisecond():
    pressure = np.zeros((32, NUM_SAMPLES), np.float32)
    pressure[:, 1000:1450] = tone(40e3, 1.8)[:, 1000:1450]
    rng = np.random.default_rng(3)
    add_noise(pressure, rng)
    audio = decoded(pressure)
    assert np.abs(audio[:, 1000:1450]).max() > 0.9
    before, after = audio[:, 500:950].std(axis=1), audio[:, 1495:1945].std(axis=1)
    assert np.median(after / before) == pytest.approx(1.0, abs=0.1)
    assert np.max(after / before) < 2.0
    assert np.abs(audio[:, 1495:1945].mean(axis=1)).max() < 5e-3


def test_overdriven_bits_run_equal():
    pressure = np.full((32, 600), 1.5, np.float32)
    words = to_pdm(pressure, np.random.default_rng(4))
    assert np.all(words[1000:5000] == 0xFFFFFFFF)


def test_the_modulators_start_differently_but_reproducibly():
    pressure = np.zeros((32, 100), np.float32)
    first, again, other = (to_pdm(pressure, np.random.default_rng(s)) for s in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_microphones_differ_as_those_of_the_real_ping_do():
    sets = [MicrophoneSet.draw(np.random.default_rng(seed)).response for seed in range(20)]
    every = np.concatenate(sets)
    assert np.std(20 * np.log10(np.abs(every))) == pytest.approx(GAIN_SPREAD_DB, rel=0.15)
    assert np.angle(every).std() == pytest.approx(PHASE_SPREAD_RAD, rel=0.15)


def test_dead_microphones_are_stuck_and_no_other_bit_changes():
    rng = np.random.default_rng(9)
    words = rng.integers(0, 2**32, 1000, dtype=np.uint32)
    before = words.copy()
    kill_microphones(words, [3, 16])
    assert stuck_mics(words) == 1 << 3 | 1 << 16
    others = ~np.uint32(1 << 3 | 1 << 16)
    np.testing.assert_array_equal(words & others, before & others)


def test_a_corrupt_half_word_carries_the_next_words_low_half():
    rng = np.random.default_rng(7)
    words = rng.integers(0, 2**32, 5000, dtype=np.uint32)
    clean = words.copy()
    corrupt_half_words(words, 20.0, rng)
    places = np.flatnonzero(words != clean)
    places = places[places > 0]
    assert 8 < places.size < 35
    np.testing.assert_array_equal(words[places] & 0xFFFF, clean[places] & 0xFFFF)
    np.testing.assert_array_equal(words[places] >> 16, clean[places + 1] & 0xFFFF)


def test_without_corruption_only_the_first_word_is_garbage():
    rng = np.random.default_rng(8)
    words = rng.integers(0, 2**32, 5000, dtype=np.uint32)
    clean = words.copy()
    corrupt_half_words(words, 0.0, rng)
    np.testing.assert_array_equal(words[1:], clean[1:])
