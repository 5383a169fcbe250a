import dataclasses

import numpy as np
import pytest

from ertis_driver.audio import PdmDecoder
from ertis_driver.bit_runs import INTERRUPTED_RUN_WORDS, STARTUP_WORDS, long_runs
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.health import check_ping, noise_dbfs
from ertis_simulator.dataset import random_scene
from ertis_simulator.microphone import corrupt_half_words, to_pdm

NUM_WORDS = 163_840
ALL = set(range(32))


def health(words):
    return check_ping(words, PdmDecoder().decode(words))


def states(words):
    return {channel.row: channel.state for channel in health(words).faulty}


def heard(number, chirp):
    return random_scene(5, number).hear(0, NUM_WORDS, chirp.samples(450e3) if chirp else None)


@pytest.fixture(scope="module")
def active():
    words = heard(0, DEFAULT_CHIRP)
    words.setflags(write=False)
    return words


@pytest.fixture(scope="module")
def passive():
    words = heard(0, None)
    words.setflags(write=False)
    return words


def with_bits(words, mic, bits, start=0, stop=NUM_WORDS):
    """The frame with other bits on one microphone."""
    changed = words.copy()
    part = changed[start:stop]
    part &= ~np.uint32(1 << mic)
    part |= (np.resize(np.asarray(bits, np.uint32), part.size) << np.uint32(mic)).astype(np.uint32)
    return changed


def heard_again(words, change):
    """The frame as microphones hear it whose sound was changed by ``change(audio)`` in place."""
    audio = PdmDecoder().decode(words).audio
    change(audio)
    return to_pdm(audio, np.random.default_rng(3))


@pytest.mark.parametrize("number", range(2))
@pytest.mark.parametrize("chirp", [DEFAULT_CHIRP, INCUMBENT_CHIRP, None])
def test_simulated_microphones_are_healthy(number, chirp):
    assert states(heard(number, chirp)) == {}


@pytest.mark.parametrize("mic", [0, 15, 16, 31])
@pytest.mark.parametrize("bit", [0, 1])
def test_a_bit_that_never_changes_names_exactly_that_microphone(active, passive, mic, bit):
    assert states(with_bits(active, mic, [bit])) == {mic: "stuck"}
    assert states(with_bits(passive, mic, [bit])) == {mic: "stuck"}


@pytest.mark.parametrize("pattern", [[0, 1], [0, 0, 1, 1], [1, 0, 0], [0, 0, 1, 0, 1, 1]])
def test_bits_that_alternate_without_noise_are_silent(active, pattern):
    assert states(with_bits(active, 7, pattern)) == {7: "silent"}


@pytest.mark.parametrize("bit", [0, 1])
def test_a_bit_that_stands_still_for_a_while_is_interrupted(active, bit):
    stop = 60_000 + INTERRUPTED_RUN_WORDS
    assert states(with_bits(active, 3, [bit], 60_000, stop)) == {3: "interrupted"}
    assert states(with_bits(active, 3, [bit], 60_000, stop - 20)) == {}
    assert states(with_bits(active, 3, [bit], 60_000)) == {3: "interrupted"}


def test_two_microphones_with_the_same_bits_name_each_other(active):
    twins = with_bits(active, 20, active >> np.uint32(4) & np.uint32(1))
    found = health(twins)
    assert [(c.row, c.state, c.twin) for c in found.faulty] == [(4, "twin", 20), (20, "twin", 4)]


def test_a_deaf_microphone_is_weak_though_it_makes_noise(active):
    def muffle(audio):
        audio[12, :1600] *= 0.2

    assert states(heard_again(active, muffle)) == {12: "weak"}


def test_a_quiet_microphone_is_weak_in_a_passive_ping_too(passive):
    decoded = PdmDecoder().decode(passive)
    # Not through the simulated modulator again: its own noise is only 9 dB down.
    decoded.audio[12] *= 0.1
    found = check_ping(passive, decoded).faulty
    assert {channel.row: channel.state for channel in found} == {12: "weak"}


def test_a_microphone_that_hisses_is_noisy(active):
    def hiss(audio):
        audio[30] += np.random.default_rng(1).normal(0, 0.03, audio.shape[1]).astype(np.float32)

    assert states(heard_again(active, hiss)) == {30: "noisy"}


def test_one_click_does_not_make_a_microphone_noisy(passive):
    def click(audio):
        audio[30, -200] += 0.9

    assert states(heard_again(passive, click)) == {}


def test_with_all_microphones_dead_there_is_no_usual_noise():
    found = health(np.full(NUM_WORDS, 0xFFFF, np.uint32))
    assert {c.row for c in found.faulty if c.state == "stuck"} == ALL
    assert found.usual_noise_dbfs is None


def test_the_direct_path_saturates_the_nearest_microphones_and_nothing_else_does(active, passive):
    saturated = health(active).saturated
    assert {6, 22} <= {channel.row for channel in saturated} < ALL
    for channel in saturated:
        assert channel.saturated_s < 0.25e-3
        assert channel.saturated_until_s < 1.5e-3  # the chirp passes its loudest at 1 ms
    assert health(passive).saturated == ()


def test_saturation_tells_when_it_ended_and_which_microphone(passive):
    def blast(audio):
        time_s = np.arange(450) / 450e3
        audio[9, 4500:4950] += 1.3 * np.sin(2 * np.pi * 40e3 * time_s).astype(np.float32)

    (channel,) = health(heard_again(passive, blast)).saturated
    assert channel.row == 9
    assert channel.state == "ok"
    # 1 ms of 1.3 times full scale, of which a good half runs equal
    assert 0.3e-3 < channel.saturated_s < 1e-3
    assert channel.saturated_until_s == pytest.approx(11e-3, abs=0.05e-3)


@pytest.mark.parametrize("amplitude", [0.3, 0.7])
def test_a_loud_sound_within_full_scale_does_not_saturate(amplitude):
    time_s = np.arange(16_384) / 450e3
    audio = np.tile((amplitude * np.sin(2 * np.pi * 50e3 * time_s)).astype(np.float32), (32, 1))
    audio[:, :100] *= np.linspace(0, 1, 100, dtype=np.float32)
    assert health(to_pdm(audio, np.random.default_rng(2))).saturated == ()


def test_noise_is_measured_in_its_band():
    # White, 20 uFS/sqrt(Hz): -94 dBFS/Hz, and 47.8 dB more in 60 kHz.
    rng = np.random.default_rng(4)
    audio = rng.normal(0, 20e-6 * np.sqrt(225e3), (32, 16_384)).astype(np.float32)
    assert np.median(noise_dbfs(audio)) == pytest.approx(-94.0 + 47.8, abs=0.4)
    time_s = np.arange(16_384) / 450e3
    for frequency_hz, expected_dbfs in ((50e3, -43.0), (8e3, -120.0), (120e3, -120.0)):
        audio = np.tile((0.01 * np.sin(2 * np.pi * frequency_hz * time_s)).astype("f4"), (32, 1))
        if expected_dbfs == -120.0:
            assert noise_dbfs(audio).max() < -70.0
        else:
            np.testing.assert_allclose(noise_dbfs(audio), expected_dbfs, atol=0.2)


def test_half_words_mended_are_told(passive):
    words = passive.copy()
    mended = health(words).half_words_repaired
    corrupt_half_words(words, 40.0, np.random.default_rng(8))
    assert mended + 25 < health(words).half_words_repaired < mended + 50


def test_the_shortest_frame_can_be_judged_and_a_shorter_one_is_refused(active):
    short = active[:32_760]
    assert states(short) == {}
    assert states(with_bits(short, 5, [1])) == {5: "stuck"}
    with pytest.raises(ValueError, match="audio of 1000 samples, expected 1024 or more"):
        health(active[:10_000])


def test_as_json_it_is_plain_values(active):
    told = health(active).to_json()
    assert told["states"] == ["ok"] * 32
    assert {len(value) for value in told.values() if isinstance(value, list)} == {32}
    assert all(type(value) is float for value in told["noise_dbfs"] + told["saturated_s"])


def runs_one_by_one(words):
    """What ``long_runs`` finds, the slow way: total, end, interrupted of each microphone."""
    found = {}
    for mic in range(32):
        bits = (words[STARTUP_WORDS:] >> np.uint32(mic)) & 1
        edges = np.flatnonzero(np.diff(bits.astype(np.int8))) + 1
        starts, ends = np.append(0, edges), np.append(edges, bits.size)
        lengths = ends - starts
        long = np.flatnonzero(lengths >= 16)
        if long.size and lengths.max() >= 256:
            found[mic] = (0, 0, True)
        elif long.size:
            found[mic] = (int(lengths[long].sum()), int(ends[long[-1]]) + STARTUP_WORDS, False)
    return found


@pytest.mark.parametrize("seed", range(40))
def test_long_runs_are_found_wherever_they_lie(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.choice([700, 32_768, 40_001]))
    words = rng.integers(0, 2**32, size, dtype=np.uint32)
    for _ in range(rng.integers(1, 12)):
        length = int(rng.choice([14, 15, 16, 17, 23, 24, 25, 40, 255, 256, 257, 5000]))
        start = int(rng.choice([rng.integers(0, size), max(size - length, 0)]))
        words = with_run(words, int(rng.integers(32)), start, length, rng.integers(2))
    runs = long_runs(words)
    fields = zip(runs.total_words, runs.end_word, strict=True)
    told = {
        mic: (total, end, bool(runs.interrupted >> mic & 1))
        for mic, (total, end) in enumerate(fields)
        if total or runs.interrupted >> mic & 1
    }
    assert told == runs_one_by_one(words)


def with_run(words, mic, start, length, bit):
    words[start : start + length] &= ~np.uint32(1 << mic)
    words[start : start + length] |= np.uint32(int(bit) << mic)
    return words


def test_what_is_found_cannot_be_changed(active):
    with pytest.raises(dataclasses.FrozenInstanceError):
        health(active).usual_noise_dbfs = 0.0
