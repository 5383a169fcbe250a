"""The detector told the range: what it prepares of a ping, and what folds may learn of it."""

import pickle

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.known_range import KnownRangeDetector
from ertis_detector.method import KnownRangePing
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.landmark import Dish
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

OPEN = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)
CHIRP = DEFAULT_CHIRP.samples(450e3)
SIZES = ("r35", "r48", "r58", "r70")


def ping(radius_mm=58, range_m=2.0, asked_m=None, chirp_name=DEFAULT_CHIRP.name):
    dish = DishObject("dish", Dish.landmark(radius_mm), (range_m, 0.0, 0.6), (np.pi, 0.0))
    words = Scene(OPEN, Pose((0.0, 0.0, 0.6), 0.0), (dish,)).hear(0, 163_840, CHIRP)
    return KnownRangePing(
        audio=PdmDecoder().decode(words).audio,
        range_m=range_m if asked_m is None else asked_m,
        azimuth_rad=0.0,
        air=Air(),
        chirp=CHIRP,
        chirp_band_hz=DEFAULT_CHIRP.band_hz,
        chirp_name=chirp_name,
        mic_positions_m=mic_positions_m(),
        emitter_position_m=np.array(EMITTER_POSITION_M),
    )


def test_the_size_that_stands_at_the_range_has_the_best_odds():
    ours = KnownRangeDetector()
    for index, size in enumerate(SIZES):
        odds = ours.prepare(ping(int(size[1:])))
        assert odds.shape == (5,)
        assert odds[:4].argmax() == index
        assert odds[4] > 2.0


def test_what_stands_elsewhere_is_not_looked_at():
    assert KnownRangeDetector().prepare(ping(asked_m=3.0)).max() < 0


def test_folds_learn_what_odds_mean():
    rng = np.random.default_rng(1)
    labels = rng.choice([*SIZES, "none"], 300)
    prepared = rng.normal(-4, 1, (300, 5))
    for row, label in zip(prepared, labels, strict=True):
        if label != "none":
            row[SIZES.index(label)] += 6
            row[4] += 6
    ours = KnownRangeDetector()
    ours.fit(prepared, labels.tolist())
    told = ours.predict(prepared)
    np.testing.assert_allclose(told.sum(axis=1), 1.0)
    assert np.mean(np.array(ours.classes)[told.argmax(axis=1)] == labels) > 0.97


def test_it_goes_to_another_process_and_back():
    ours = KnownRangeDetector()
    there = pickle.loads(pickle.dumps(ours))  # noqa: S301  # our own
    np.testing.assert_array_equal(there.prepare(ping()), ours.prepare(ping()))


def test_a_chirp_without_a_model_is_named():
    from ertis_detector.errors import ModelMismatch

    with pytest.raises(ModelMismatch, match="linear:1:2"):
        KnownRangeDetector().prepare(ping(chirp_name="linear:1:2"))
