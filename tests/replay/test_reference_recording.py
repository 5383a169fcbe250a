"""One real ping of an eRTIS: not ours to copy, so it is fetched from the package index."""

import json

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.direct_path import find_direct_path
from ertis_driver.health import check_ping

pytestmark = pytest.mark.index


@pytest.fixture(scope="session")
def reference(rtisdev_folder):
    """The recording among the package's files; nothing of the package is run."""
    return rtisdev_folder / "rtisdev" / "simulate.bin"


@pytest.fixture(scope="session")
def words(reference):
    return np.fromfile(reference, "<u4").astype(np.uint32)


def test_the_recording_is_one_default_frame(words):
    assert words.shape == (163_840,)


def test_seven_corrupt_half_words_are_mended(words):
    assert PdmDecoder().decode(words).half_words_repaired == 7


def test_mending_takes_the_clicks_off_microphones_16_to_31(words):
    audio = PdmDecoder().decode(words).audio
    quiet = np.abs(np.diff(audio[:, 8000:], 4, axis=1))  # what is left of it above the band
    crest = quiet.max(axis=1) / np.median(quiet, axis=1)
    assert np.median(crest[16:]) < 1.5 * np.median(crest[:16])


def test_its_microphones_are_all_healthy_and_the_nearest_are_clipped_by_the_direct_path(words):
    health = check_ping(words, PdmDecoder().decode(words))
    assert health.faulty == ()
    assert health.half_words_repaired == 7
    assert health.usual_noise_dbfs == pytest.approx(-54.8, abs=0.5)
    assert [channel.row for channel in health.saturated] == [2, 4, 5, 6, 7, 19, 22, 30]
    for channel in health.saturated:
        assert 10e-6 < channel.saturated_s < 0.1e-3
        assert channel.saturated_until_s < 0.6e-3


def test_a_microphone_of_it_forced_still_is_named(words):
    stuck = words | np.uint32(1 << 16)
    (channel,) = check_ping(stuck, PdmDecoder().decode(stuck)).faulty
    assert (channel.row, channel.state) == (16, "stuck")


def test_probe_calls_it_healthy_and_hears_its_direct_path(reference, capsys):
    assert main(["probe", f"replay:{reference}", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["source"], told["chirp_heard"]) == ("replay", INCUMBENT_CHIRP.name)
    (path,) = told["direct_paths"]
    assert path["heard"]
    assert path["delay_s"] == pytest.approx(0.19e-3, abs=0.03e-3)


def test_detect_tells_of_the_reflectors_and_of_no_landmark(reference, capsys):
    assert main(["detect", str(reference), "--json", "--reflectors", "5"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    told = json.loads(line)
    assert told["ping_index"] == 0
    assert told["landmarks"] == []
    strongest = sorted(told["reflectors"], key=lambda one: -one["level_db"])[:2]
    by_range = sorted(strongest, key=lambda one: one["range_m"])
    for found, (range_m, azimuth_deg) in zip(by_range, [(3.20, -7.7), (3.74, 5.5)], strict=True):
        assert found["range_m"] == pytest.approx(range_m, abs=0.03)
        assert np.rad2deg(found["azimuth_rad"]) == pytest.approx(azimuth_deg, abs=1.5)
        assert found["level_db"] > 35.0


def test_its_direct_path_is_the_incumbents_chirp_and_not_that_reversed(words):
    audio = PdmDecoder().decode(words).audio
    found = find_direct_path(audio, INCUMBENT_CHIRP)
    assert found.heard
    assert 0.0 < found.delay_s < 0.5e-3
    reversed_chirp = CustomChirp(tuple(INCUMBENT_CHIRP.dac_codes()[::-1].tolist()))
    other = find_direct_path(audio, reversed_chirp)
    assert not other.heard
    assert other.level_over_reversed_db < -6
