import struct

import numpy as np
import pytest
from scipy.io import wavfile

from ertis_driver.errors import RecordingError
from ertis_driver.wav import WavWriter

AUDIO = np.random.default_rng(3).standard_normal((32, 1001)).astype(np.float32)


@pytest.mark.parametrize(("limit", "magic"), [(2**32 - 1, b"RIFF"), (100_000, b"RF64")])
def test_blocks_are_one_file_that_others_read(tmp_path, limit, magic):
    with WavWriter(tmp_path / "a.wav", 32, 450_000, max_riff_bytes=limit) as writer:
        writer.write(AUDIO)
        writer.write(AUDIO[:, :7])
    rate_hz, samples = wavfile.read(tmp_path / "a.wav")
    assert rate_hz == 450_000
    np.testing.assert_array_equal(samples, np.concatenate([AUDIO.T, AUDIO.T[:7]]))
    assert (tmp_path / "a.wav").read_bytes().startswith(magic)


def test_the_sizes_of_an_rf64_stand_in_its_ds64(tmp_path):
    with WavWriter(tmp_path / "a.wav", 32, 450_000, max_riff_bytes=0, comment="sim") as writer:
        writer.write(AUDIO)
    data = (tmp_path / "a.wav").read_bytes()
    assert data[12:16] == b"ds64"
    riff, samples, frames = struct.unpack_from("<QQQ", data, 20)
    assert riff == len(data) - 8
    assert (samples, frames) == (AUDIO.nbytes, AUDIO.shape[1])
    assert struct.unpack_from("<I", data, 4) == (0xFFFFFFFF,)
    assert b"ICMT" in data
    assert len(data) % 2 == 0


def test_other_channels_and_existing_files_are_refused(tmp_path):
    with (
        WavWriter(tmp_path / "a.wav", 32, 450_000) as writer,
        pytest.raises(RecordingError, match="expected 32 channels"),
    ):
        writer.write(AUDIO[:31])
    with pytest.raises(RecordingError, match="exists"):
        WavWriter(tmp_path / "a.wav", 32, 450_000)
