import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, Chirp
from ertis_driver.errors import SettingsError

# 0 or audible: a ramp of 1e-300 overflows where nobody would look for it.
ramps = st.just(0.0) | st.floats(1e-6, 0.5)
kinds = st.sampled_from(["hyperbolic", "linear"])
frequencies = st.integers(1_000, 200_000).map(float)


@given(kinds, frequencies, frequencies, st.floats(2e-4, 6e-3), ramps)
def test_every_playable_chirp_has_12_bit_codes_that_begin_idle(kind, start, stop, duration, ramp):
    if kind == "hyperbolic" and start == stop:
        return
    chirp = Chirp(kind, start, stop, duration, ramp)
    codes = chirp.dac_codes()
    assert codes.shape == (chirp.num_dac_samples,)
    assert codes.min() >= 1
    assert codes.max() <= 4095
    assert codes[0] == 2048


def test_the_incumbents_chirp_has_1126_samples():
    assert INCUMBENT_CHIRP.num_dac_samples == 1126
    assert INCUMBENT_CHIRP.dac_codes().size == 1126


@pytest.mark.parametrize("kind", ["hyperbolic", "linear"])
def test_the_sweep_runs_from_start_to_stop(kind):
    chirp = Chirp(kind, 80_000.0, 20_000.0, ramp=0.0)
    rate = 10e6
    crossings = np.flatnonzero(np.diff(np.signbit(chirp.samples(rate)))) / rate
    frequency = 0.5 / np.diff(crossings)
    assert frequency[0] == pytest.approx(80_000, rel=0.02)
    assert frequency[-1] == pytest.approx(20_000, rel=0.06)
    middle = frequency[np.searchsorted(crossings, chirp.duration_s / 2)]
    expected = {"hyperbolic": 32_000, "linear": 50_000}[kind]  # 1/f, or f, is the mean of the ends
    assert middle == pytest.approx(expected, rel=0.05)


def test_the_ramps_take_a_tenth_at_both_ends():
    flat, ramped = Chirp(ramp=0.0), Chirp(ramp=0.1)
    times = np.linspace(0, flat.duration_s, 4001)
    difference = np.abs(flat.at(times) - ramped.at(times)) > 1e-9
    assert difference[:400].any()
    assert difference[-400:].any()
    assert not difference[401:-401].any()


def test_there_is_silence_before_and_after_it():
    assert not DEFAULT_CHIRP.at(np.array([-1e-6, DEFAULT_CHIRP.duration_s + 1e-6])).any()


def test_its_name_reads_back():
    assert Chirp.parse(DEFAULT_CHIRP.name) == DEFAULT_CHIRP


@pytest.mark.parametrize(
    "text",
    ["", "hyperbolic", "sawtooth:1:2:3", "linear:a:2:3", "linear:80000:20000:0.0025:1"],
)
def test_a_malformed_name_is_refused_in_one_line(text):
    with pytest.raises(SettingsError, match="expected") as caught:
        Chirp.parse(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"dac_rate_hz": 150_000},
        {"f_start_hz": 225_000.0},
        {"f_stop_hz": 0.0},
        {"f_stop_hz": 80_000.0},
        {"ramp": 0.6},
        {"duration_s": 0.0},
        {"duration_s": float("nan")},
        {"duration_s": 1e-4},
        {"duration_s": 1.0},
    ],
)
def test_what_the_device_cannot_play_is_refused(changes):
    with pytest.raises(SettingsError):
        Chirp(**changes)
