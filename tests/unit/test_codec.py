import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver.codec import (
    PLANES,
    decode_planes,
    decode_recorded,
    encode_planes,
    encode_recorded,
)
from ertis_driver.errors import FrameCorrupt

WORDS = np.random.default_rng(1).integers(0, 2**32, 32_768, dtype=np.uint32)


@given(st.lists(st.integers(0, 2**32 - 1), min_size=32, max_size=128))
def test_any_words_come_back_as_they_were(values):
    words = np.array(values[: len(values) // 32 * 32], np.uint32)
    decoded = decode_planes(encode_planes(words), words.size)
    np.testing.assert_array_equal(decoded, words)
    assert decoded.dtype == np.uint32
    assert decoded.flags.writeable


def test_the_layout_is_the_documented_one():
    plain = zstandard.decompress(encode_planes(WORDS))
    rows = np.frombuffer(plain, "<u4").reshape(32, -1)
    before = np.concatenate([[0], WORDS[:-1]]).astype(np.uint32)
    for mic, block, bit in ((0, 0, 0), (7, 3, 31), (31, 1023, 5)):
        changed = (WORDS ^ before)[32 * block + bit]
        assert rows[mic, block] >> bit & 1 == changed >> mic & 1


def test_microphones_that_do_nothing_cost_nothing():
    quiet = WORDS & np.uint32(0xFFFF)
    assert len(encode_planes(quiet)) < 0.51 * quiet.nbytes


def test_words_that_are_no_squares_of_bits_are_refused():
    with pytest.raises(ValueError, match="a multiple of 32"):
        encode_planes(WORDS[:33])


def test_a_compressed_frame_keeps_its_index():
    raw = decode_recorded(encode_recorded(2**32 - 1, WORDS, PLANES), PLANES, WORDS.size)
    assert raw.index == 2**32 - 1
    np.testing.assert_array_equal(raw.words, WORDS)


BOMB = zstandard.ZstdCompressor(level=19).compress(bytes(1 << 28))  # 256 MB in 8 kB


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0\0\0",
        encode_recorded(1, WORDS, PLANES)[:-1],
        encode_recorded(1, WORDS[:64], PLANES),
        WORDS.size.to_bytes(4, "little") * 2 + b"no zstd",
        WORDS.size.to_bytes(4, "little") * 2 + BOMB,
        WORDS.size.to_bytes(4, "little") * 2 + encode_planes(WORDS[:64]),
    ],
)
def test_whatever_is_no_compressed_frame_is_refused(data):
    with pytest.raises((FrameCorrupt, ValueError), match="compressed frame"):
        decode_recorded(data, PLANES, WORDS.size)
