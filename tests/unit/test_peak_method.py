import pickle
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.peak_method import PeakMethod
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.landmark import Dish, dish_echoes
from ertis_simulator.propagation import render
from ertis_simulator.sensor_response import shipped_response

SAMPLES = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
SENSOR = (shipped_response().frequency_hz, shipped_response().level_db)
RANGE_M, AZIMUTH_RAD = 1.5, 0.2
LABELS = ("r35", "r48", "r58", "r70", "none")


@dataclass
class Ping:
    audio: np.ndarray
    range_m: float = RANGE_M
    azimuth_rad: float = AZIMUTH_RAD
    air: Air = field(default_factory=Air)
    chirp: np.ndarray = field(default_factory=lambda: SAMPLES)
    chirp_band_hz: tuple = DEFAULT_CHIRP.band_hz
    mic_positions_m: np.ndarray = field(default_factory=mic_positions_m)
    emitter_position_m: np.ndarray = field(default_factory=lambda: np.array(EMITTER_POSITION_M))


def heard(label, tilt_rad, rng, air=None):
    """One ping: a dish or two small things among other small things."""
    emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
    parts = []
    if label != "none":
        facing = AZIMUTH_RAD + np.pi + tilt_rad
        axis = np.array([np.cos(facing), np.sin(facing), 0.0])
        at = RANGE_M * np.array([np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD), 0.0])
        parts.append(dish_echoes(Dish.landmark(float(label[1:])), axis, at, emitter, mics))
    for _ in range(6):
        azimuth, distance = rng.uniform(-0.4, 0.6), RANGE_M + rng.uniform(-0.3, 0.3)
        at = distance * np.array([np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.1, 0.1)])
        out, back = np.linalg.norm(at - emitter), np.linalg.norm(at - mics, axis=1)
        length_m = 10 ** (rng.normal(-34, 4) / 20)
        parts.append(Echoes.of(out + back, length_m / (out * back)))
    num = round(2 * (RANGE_M + 0.5) / 343 * AUDIO_RATE_HZ) + SAMPLES.size
    flat = np.ones(len(mics), np.complex64)
    audio = render(Echoes.join(parts), air or Air(), SAMPLES, num, flat)
    return audio + rng.normal(0, 1e-4, audio.shape).astype(np.float32)


@pytest.fixture(scope="module")
def pings():
    rng = np.random.default_rng(1)
    labels = LABELS * 6
    tilts = rng.uniform(-0.35, 0.35, len(labels))
    return labels, [Ping(heard(one, t, rng)) for one, t in zip(labels, tilts, strict=True)]


@pytest.fixture(scope="module")
def prepared(pings):
    method = PeakMethod(sensor=SENSOR)
    return np.stack([method.prepare(ping) for ping in pings[1]])


def share_right(method, rows, labels):
    probabilities = method.predict(rows)
    np.testing.assert_allclose(probabilities.sum(axis=1), 1)
    said = [method.classes[one] for one in probabilities.argmax(axis=1)]
    return np.mean([one == other for one, other in zip(said, labels, strict=True)])


def test_sizes_and_none_are_told_from_pings_that_were_not_learnt_from(pings, prepared):
    method = PeakMethod(sensor=SENSOR)
    method.fit(prepared[:15], pings[0][:15])
    assert method.classes == LABELS
    assert share_right(method, prepared[15:], pings[0][15:]) >= 0.8


def test_what_is_learnt_is_level_and_clutter(prepared, pings):
    method = PeakMethod(sensor=SENSOR)
    quiet = prepared.copy()
    quiet[:, 2 + 12 :] -= 15.0  # a sonar with an amplifier turned down
    method.fit(prepared, pings[0])
    loud = method.likelihood.statistics
    first = method.predict(prepared)
    method.fit(quiet, pings[0])
    assert method.likelihood.statistics.gain_db == pytest.approx(loud.gain_db - 15)
    np.testing.assert_allclose(method.predict(quiet), first, atol=1e-6)


def test_a_method_crosses_to_another_process_and_learns_there(pings, prepared):
    here, there = PeakMethod(), pickle.loads(pickle.dumps(PeakMethod()))  # noqa: S301
    for method in (here, there):
        method.fit(prepared, pings[0])
    np.testing.assert_array_equal(here.predict(prepared), there.predict(prepared))


def test_without_an_azimuth_the_loudest_direction_is_taken(pings):
    ping = pings[1][3]
    known, found = (
        PeakMethod().prepare(replace(ping, azimuth_rad=azimuth))
        for azimuth in (AZIMUTH_RAD, np.nan)
    )
    aside = PeakMethod().prepare(replace(ping, azimuth_rad=-0.5))
    strongest = 2 + 12
    assert found[strongest] == pytest.approx(known[strongest], abs=1.0)
    assert aside[strongest] < known[strongest] - 6


def test_a_beam_hears_less_clutter_than_one_microphone(pings):
    rows = [
        np.stack([PeakMethod(which).prepare(ping) for ping in pings[1][4::5]])
        for which in ("beam", 7)
    ]
    beam, single = (float(np.nanmean(row[:, 2 + 12 : -1])) for row in rows)
    assert beam < single - 3


def test_peaks_lie_where_they_would_in_air_of_20_degrees():
    rng = np.random.default_rng(2)
    cold = Air(-5.0)
    ping = Ping(heard("r70", 0.0, rng, cold), air=cold)
    row = PeakMethod(sensor=SENSOR).prepare(ping)
    assert row[2] == pytest.approx(2.74e-6 * 70, abs=12e-6)


def test_a_label_beyond_the_ping_is_silence_and_no_crash(pings):
    row = PeakMethod().prepare(replace(pings[1][0], range_m=9.0))
    assert np.isnan(row[2:-1]).all()


def test_what_cannot_be_done_is_refused_with_the_reason(pings, prepared):
    with pytest.raises(ValueError, match="'beam' or an index"):
        PeakMethod("mean")
    with pytest.raises(ValueError, match="fit before predict"):
        PeakMethod().predict(prepared)
    with pytest.raises(ValueError, match="expected one or more lengths"):
        PeakMethod().fit(prepared, ["none"] * len(prepared))
    with pytest.raises(ValueError, match="microphone 40"):
        PeakMethod(40).prepare(pings[1][0])
