"""The whole chain on simulated frames, with the model that ships. Without a model it fails."""

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.detector import LandmarkDetector
from ertis_detector.errors import DetectorError, ModelMismatch
from ertis_detector.features import NUM_FEATURES
from ertis_detector.model import load_model, shipped_model
from ertis_detector.proposals import propose
from ertis_detector.scanner import MAX_PROPOSALS, MIN_SNR_DB, Scanner
from ertis_driver.audio import PdmDecoder
from ertis_driver.audio_filter import FILTER_VERSION
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.frame import DEFAULT_NUM_WORDS
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.clutter import Clutter
from ertis_simulator.dataset import random_scene
from ertis_simulator.landmark import Dish
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

CHIRP = DEFAULT_CHIRP.samples(450e3)
OPEN = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)


def scanner(**changes):
    given = {
        "mic_positions_m": mic_positions_m(),
        "emitter_position_m": np.array(EMITTER_POSITION_M),
        "chirp_samples": CHIRP,
        "chirp_band_hz": (20e3, 80e3),
        "num_samples": DEFAULT_NUM_WORDS // 10,
        "air": Air(),
    }
    return Scanner(**{**given, **changes})


def scene(*dishes, clutter=None, seed=1):
    start = Pose((0.0, 0.0, 0.6), 0.0)
    return Scene(OPEN, start, tuple(dishes), clutter or Clutter.none(), seed=seed)


def landmark(radius_mm, range_m, azimuth_deg=0.0, tilt_deg=0.0):
    azimuth = np.deg2rad(azimuth_deg)
    vertex = (range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.6)
    facing = float(azimuth + np.pi + np.deg2rad(tilt_deg))
    return DishObject(f"r{radius_mm}", Dish.landmark(radius_mm), vertex, (facing, 0.0))


def audio_of(scene, ping_index=0, chirp=CHIRP):
    return PdmDecoder().decode(scene.hear(ping_index, DEFAULT_NUM_WORDS, chirp)).audio


@pytest.fixture(scope="module")
def detector():
    model = load_model(shipped_model(DEFAULT_CHIRP.name))
    return LandmarkDetector(model, scanner(), chirp=DEFAULT_CHIRP.name, audio_filter=FILTER_VERSION)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_frontal_landmark_is_reported_where_and_as_what_it_is(detector, seed):
    found = detector.detect(audio_of(scene(landmark(48, 1.8), seed=seed)))
    assert [one.label for one in found] == ["r48"]
    assert found[0].radius_m == 0.048
    assert found[0].range_m == pytest.approx(1.8, abs=0.03)
    assert abs(np.rad2deg(found[0].azimuth_rad)) <= 1.5
    assert sum(found[0].probabilities.values()) == pytest.approx(1.0, abs=1e-4)
    assert found[0].snr_db > 14.0
    variances = np.diag(np.array(found[0].covariance))
    assert np.all(variances > 0)


def test_a_landmark_to_the_left_has_positive_azimuth(detector):
    found = detector.detect(audio_of(scene(landmark(70, 1.8, 8.0))))
    assert len(found) == 1
    assert np.rad2deg(found[0].azimuth_rad) == pytest.approx(8.0, abs=1.5)
    assert found[0].range_m == pytest.approx(1.8, abs=0.03)


def test_two_landmarks_are_two_detections_most_probable_first(detector):
    there = scene(landmark(48, 1.6, 8.0), landmark(35, 2.4, -5.0))
    found = detector.detect(audio_of(there))
    assert sorted(one.label for one in found) == ["r35", "r48"]
    best = [one.probabilities[one.label] for one in found]
    assert best == sorted(best, reverse=True)


def test_far_clutter_is_seldom_taken_for_a_landmark(detector):
    rng = np.random.default_rng(4)
    reports = 0
    for ping in range(12):
        clutter = Clutter.scatter((4.0, 5.5), (-2.5, 2.5), 8.0, rng)
        assert clutter.points.positions_m.size
        reports += len(detector.detect(audio_of(scene(clutter=clutter), ping)))
    assert reports <= 2  # its card says 0.12 false alarms a ping


def test_an_empty_room_reports_none(detector):
    assert detector.detect(audio_of(scene())) == []


def test_the_emitters_own_ringing_is_rarely_a_candidate():
    ears = scanner()
    found = [ears.candidates(*ears.image(audio_of(scene(seed=seed)))) for seed in range(8)]
    assert sum(map(bool, found)) <= 2  # of 24 sonars 5; without its own threshold all of them


@pytest.mark.parametrize(("radius_mm", "range_m"), [(35, 0.62), (70, 0.65)])
def test_a_dish_is_a_candidate_while_the_emitter_still_rings(radius_mm, range_m):
    ears = scanner()
    found = ears.candidates(*ears.image(audio_of(scene(landmark(radius_mm, range_m, 5.0, 20.0)))))
    assert any(abs(one.location.range_m - range_m) < 0.05 for one in found)


def test_who_only_listens_reports_none(detector):
    assert detector.detect(audio_of(scene(landmark(48, 1.8)), chirp=None)) == []


def test_nothing_is_reported_under_the_probability_asked_for(detector):
    strict = LandmarkDetector(
        detector.model,
        detector.scanner,
        chirp=DEFAULT_CHIRP.name,
        audio_filter=FILTER_VERSION,
        min_probability=1.01,
    )
    assert strict.detect(audio_of(scene(landmark(48, 1.8)))) == []


def test_the_same_audio_gives_the_same_report(detector):
    audio = audio_of(scene(landmark(58, 2.0)))
    before = audio.copy()
    once, again = detector.detect(audio), detector.detect(audio)
    assert once == again
    np.testing.assert_array_equal(audio, before)


def test_the_scanner_hears_a_dish_where_its_rings_come_from():
    ears = scanner()
    baseband, scape = ears.image(audio_of(scene(landmark(70, 2.0, -10.0))))
    found = ears.candidates(baseband, scape)
    loudest = max(found, key=lambda one: one.snr_db)
    ring_m = 2.0 + (np.sqrt(2) - 1) * 1.1333 * 0.070
    assert loudest.location.range_m == pytest.approx(ring_m, abs=0.015)
    assert np.rad2deg(loudest.location.azimuth_rad) == pytest.approx(-10.0, abs=1.0)
    assert ears.features(baseband, [loudest]).shape == (1, NUM_FEATURES)


def test_a_strong_reflectors_sidelobes_and_floor_echoes_are_no_candidates():
    ears, dropped = scanner(), 0
    for number in range(6):
        loud = random_scene(6, number)
        samples = loud.hear(0, DEFAULT_NUM_WORDS, CHIRP)
        baseband, scape = ears.image(PdmDecoder().decode(samples).audio)
        proposals = propose(scape, max_count=MAX_PROPOSALS, min_snr_db=MIN_SNR_DB)
        found = ears.candidates(baseband, scape)
        dropped += len(proposals) - len(found)
        for one in found:
            weaker = [other for other in found if other.snr_db < one.snr_db - 12.0]
            for other in weaker:
                assert abs(other.location.range_m - one.location.range_m) > 0.2
    assert dropped > 0


def test_a_model_for_another_chirp_is_refused(detector):
    with pytest.raises(ModelMismatch, match="hyperbolic:50000:25000"):
        LandmarkDetector(
            detector.model,
            detector.scanner,
            chirp=INCUMBENT_CHIRP.name,
            audio_filter=FILTER_VERSION,
        )


@pytest.mark.parametrize("shape", [(32, 100), (31, 16_384), (16_384,)])
def test_audio_of_another_shape_is_refused_with_both_shapes(shape):
    with pytest.raises(DetectorError, match=r"expected \(32, 16384\)"):
        scanner().image(np.zeros(shape, np.float32))


def test_a_chirp_outside_the_sensors_band_is_refused():
    with pytest.raises(DetectorError, match="widen it"):
        scanner(chirp_band_hz=(100e3, 160e3))


def test_listening_too_briefly_is_refused():
    with pytest.raises(DetectorError, match="listen for longer"):
        scanner(num_samples=3276)
