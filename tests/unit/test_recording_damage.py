"""What the fuzzer found in the recording reader, and what it cannot build by itself."""

import pytest
from mcap.writer import CompressionType
from seeds import recording

from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording

KINDS = list(CompressionType)


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_that_somebody_compressed_is_read(tmp_path, kind):
    (tmp_path / "a.mcap").write_bytes(recording(kind))
    (ping,) = open_recording(tmp_path / "a.mcap")
    assert (ping.frame.ping_index, ping.truth) == (7, {"landmarks": []})


@pytest.mark.parametrize("kind", [CompressionType.LZ4, CompressionType.ZSTD])
def test_damage_in_compressed_data_is_a_recording_error(tmp_path, kind):
    magic = {CompressionType.LZ4: b"\x04\x22\x4d\x18", CompressionType.ZSTD: b"\x28\xb5\x2f\xfd"}
    whole = recording(kind)
    at = whole.index(magic[kind])
    damaged = whole[:at] + bytes(8) + whole[at + 8 :]
    (tmp_path / "a.mcap").write_bytes(damaged)
    with pytest.raises(RecordingError, match=r"damaged at byte .*after 0 whole pings"):
        list(open_recording(tmp_path / "a.mcap"))


def test_a_truth_nested_without_end_is_a_recording_error(tmp_path):
    (tmp_path / "a.mcap").write_bytes(recording(CompressionType.NONE, truth=b"[" * 200_000))
    with pytest.raises(RecordingError, match=r"damaged at byte .*after 0 whole pings"):
        list(open_recording(tmp_path / "a.mcap"))
