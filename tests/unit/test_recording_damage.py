"""What the fuzzer found in the recording reader, and what it cannot build by itself."""

import struct
import subprocess
import sys

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, Metadata
from mcap.writer import CompressionType
from seeds import recording

from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording
from ertis_driver.recording_info import RecordingInfo, to_strings

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


def hostile_files(folder):
    """Small files that ask for much memory, one way or another."""
    piece, pieces = bytes(1 << 20), 600
    zstd = zstandard.ZstdCompressor().compressobj()
    packed = {"zstd": b"".join(zstd.compress(piece) for _ in range(pieces)) + zstd.flush()}
    with lz4.frame.LZ4FrameCompressor() as lz:
        parts = [lz.begin(), *(lz.compress(piece) for _ in range(pieces)), lz.flush()]
    packed["lz4"] = b"".join(parts)
    info = to_strings(RecordingInfo("sim", None, 32_768))
    for kind, data in packed.items():
        for size in (1 << 26, 1 << 62) if kind == "zstd" else (1 << 24, 1 << 30):
            builder = RecordBuilder()
            Metadata("ertis", info).write(builder)
            Chunk(kind, data, 0, 0, 0, size).write(builder)
            path = folder / f"{kind}{size}.mcap"
            path.write_bytes(b"\x89MCAP0\r\n" + builder.end())
            yield path
    for opcode in (1, 5, 6, 12):
        path = folder / f"length{opcode}.mcap"
        path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", opcode, 1 << 40) + bytes(1000))
        yield path


JUDGE = """
import resource, sys
from pathlib import Path
from ertis_driver.errors import RecordingError
from ertis_driver.inspect_recording import inspect
from ertis_driver.recover import recover
before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for name in sys.argv[1:]:
    path = Path(name)
    try:
        damage = inspect(path, check=True).damage
        assert damage is not None and "\\n" not in str(damage), path
    except RecordingError as error:
        assert "\\n" not in str(error), path
    try:
        recover(path, path.with_suffix(".saved"))
        raise AssertionError(path)
    except RecordingError as error:
        assert "\\n" not in str(error), path
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb)
"""


def test_no_hostile_file_takes_a_gigabyte_and_each_gives_one_line(tmp_path):
    files = [str(path) for path in hostile_files(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-c", JUDGE, *files], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 400_000  # kB
