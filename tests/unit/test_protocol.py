import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver import protocol
from ertis_driver.errors import FrameCorrupt, SettingsError, WrongDevice
from ertis_driver.protocol import encode_frame

NUM_WORDS = 6


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 2**32 - 1), min_size=1))
def test_a_frame_decodes_to_what_was_encoded(index, words):
    frame = protocol.decode_frame(encode_frame(index, np.array(words, np.uint32)))
    assert (frame.index, frame.words.tolist()) == (index, words)


@pytest.mark.parametrize("damage", ["header", "footer", "short", "empty", "odd"])
def test_a_damaged_frame_is_refused(damage):
    data = encode_frame(1, np.zeros(NUM_WORDS, np.uint32))
    broken = {
        "header": b"\0" + data[1:],
        "footer": data[:-1] + b"\0",
        "short": data[:-4],
        "empty": b"",
        "odd": data + b"\0",
    }[damage]
    with pytest.raises(FrameCorrupt, match="expected"):
        protocol.decode_frame(broken)


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (("Y",), b"!Y,0,0,0\n"),
        (("G", 655_360), b"!G,655360,0,0\n"),
        (("C", 7, 2048), b"!C,7,2048,0\n"),
        (("J", 1, 2), b"!J,1,2,0,0\n"),
        (("A", 1), b"!A,1,0,0\n"),
    ],
)
def test_a_command_is_one_line(args, line):
    assert protocol.encode_command(*args) == line


@pytest.mark.parametrize(
    "args",
    [("Q",), ("Y", 1), ("C", 1), ("C", 65_535, 0), ("C", 0, 4096), ("D", 159_999), ("J", 1, 3)],
)
def test_a_command_out_of_range_is_refused(args):
    with pytest.raises(SettingsError, match="expected"):
        protocol.encode_command(*args)


def test_a_frame_size_is_in_bytes_and_a_multiple_of_its_step():
    assert protocol.encode_frame_size(163_840) == b"!G,655360,0,0\n"
    with pytest.raises(SettingsError, match="multiple of 32768"):
        protocol.encode_frame_size(163_841)


def test_the_two_trigger_forms_are_opposite():
    assert protocol.encode_trigger(active=True) == b"!A,1,0,0\n"
    assert protocol.encode_trigger(active=False) == b"!A,0,0,0\n"
    assert protocol.encode_trigger(active=True, form="windows") == b"!A,0,0,0"


@pytest.mark.parametrize("source", ["live", "sim", "replay"])
def test_a_version_word_says_version_and_source(source):
    word = protocol.encode_version("2.3.4", source)
    assert word & 0xFFFFFF == 131_844
    assert protocol.parse_firmware(word) == "2.3.4"
    assert protocol.parse_source(word) == source


def test_a_version_word_with_another_mark_is_no_ertis():
    with pytest.raises(WrongDevice, match="0x4f020304"):
        protocol.parse_source(ord("O") << 24 | 0x020304)


def test_the_chirp_hash_is_blind_to_order():
    codes = np.array([2048, 4095, 1, 7], np.uint16)
    assert protocol.chirp_hash(codes) == 2048 ^ 4095 ^ 1 ^ 7
    assert protocol.chirp_hash(codes[::-1]) == protocol.chirp_hash(codes)
