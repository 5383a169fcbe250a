from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, PAPER_LONG_CHIRP, PAPER_SHORT_CHIRP
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.direct_path import find_direct_path
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.scene_file import load_scene

NUM_WORDS = 98_304


@pytest.fixture(scope="module")
def scene():
    return load_scene(Path(str(resources.files("ertis_simulator") / "scenes/demo.yaml")))


def heard(scene, samples):
    words = scene.hear(0, NUM_WORDS, samples)
    return PdmDecoder().decode(words[:98_300]).audio


@pytest.mark.parametrize(
    "chirp", [DEFAULT_CHIRP, INCUMBENT_CHIRP, PAPER_SHORT_CHIRP, PAPER_LONG_CHIRP]
)
def test_a_chirp_is_told_from_its_reversal(scene, chirp):
    samples = chirp.samples(AUDIO_RATE_HZ)
    right = find_direct_path(heard(scene, samples), chirp)
    assert right.heard
    assert right.level_over_reversed_db > 10
    # The emitter is 5 cm away; its near field beside it is not flat, which delays the peak. In the
    # real ping, with the second of these chirps, it is 190 us.
    assert right.delay_s == pytest.approx(0.05 / 343, abs=80e-6)
    wrong = find_direct_path(heard(scene, samples[::-1].copy()), chirp)
    assert not wrong.heard
    assert wrong.level_over_reversed_db < -6
    assert np.isnan(wrong.delay_s)


def test_a_passive_ping_has_no_direct_path(scene):
    audio = heard(scene, None)
    assert not find_direct_path(audio, DEFAULT_CHIRP).heard
    assert find_direct_path(audio, DEFAULT_CHIRP).peak_ratio < 4


def test_a_tone_that_is_its_own_reversal_is_heard_without_a_direction(scene):
    times = np.arange(1000) / AUDIO_RATE_HZ
    burst = CustomChirp.from_samples(np.hanning(1000) * np.sin(2 * np.pi * 50e3 * times))
    found = find_direct_path(heard(scene, burst.samples(AUDIO_RATE_HZ)), burst)
    assert found.heard
    assert np.isnan(found.level_over_reversed_db)


def test_silence_has_no_direct_path():
    found = find_direct_path(np.zeros((32, 4000), np.float32), DEFAULT_CHIRP)
    assert not found.heard


@pytest.mark.parametrize("shape", [(4000,), (32, 1000)])
def test_audio_of_another_shape_is_refused(shape):
    with pytest.raises(ValueError, match="expected"):
        find_direct_path(np.zeros(shape, np.float32), DEFAULT_CHIRP)
