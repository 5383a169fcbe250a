"""Bytes to and from the firmware: commands, replies, frames. Pure; no ports here.

Everything is little-endian. A command is an ASCII line, its reply one 32-bit word, but for ``A``,
whose reply is a frame: header word, index, N PDM words, footer word.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import (
    MAX_DAC_RATE_HZ,
    MAX_DAC_SAMPLES,
    MIN_DAC_RATE_HZ,
    MIN_DAC_SAMPLES,
)
from ertis_driver.device import MAX_EMISSIONS, MAX_NUM_WORDS, WORDS_STEP
from ertis_driver.errors import FrameCorrupt, SettingsError, WrongDevice
from ertis_driver.frame import Source

HEADER = 0x51534E12
FOOTER = 0x2F418672
HEADER_BYTES = struct.pack("<I", HEADER)
FOOTER_BYTES = struct.pack("<I", FOOTER)
FRAME_OVERHEAD_BYTES = 12  # header, index, footer
REPLY_BYTES = 4
INDEX_MODULUS = 2**32

TriggerForm = Literal["linux", "windows"]
Bytes = bytes | bytearray | memoryview

# The wire has no identity field, and events must stay honest about who made them: our emulator
# marks itself in bits 24-31 of the version word, which the firmware leaves 0.
SOURCE_MARKS: dict[int, Source] = {0: "live", ord("S"): "sim", ord("R"): "replay"}


@dataclass(frozen=True, slots=True)
class CommandSpec:
    """What a command letter means and the inclusive range of each argument that it takes."""

    meaning: str
    ranges: tuple[tuple[int, int], ...] = ()


COMMANDS: dict[str, CommandSpec] = {
    "Y": CommandSpec("firmware version"),
    "G": CommandSpec("frame payload, bytes", ((4 * WORDS_STEP, 4 * MAX_NUM_WORDS),)),
    "F": CommandSpec("PDM clock: 0 = 4.5 MHz, 1 = 1.125 MHz", ((0, 1),)),
    "D": CommandSpec("DAC rate, Hz", ((MIN_DAC_RATE_HZ, MAX_DAC_RATE_HZ),)),
    "E": CommandSpec("number of DAC samples", ((MIN_DAC_SAMPLES, MAX_DAC_SAMPLES),)),
    "C": CommandSpec("one DAC sample: index, code", ((0, MAX_DAC_SAMPLES - 1), (0, 4095))),
    "L": CommandSpec("XOR of the DAC codes held"),
    "I": CommandSpec("emissions per ping", ((1, MAX_EMISSIONS),)),
    "B": CommandSpec("ping counter", ((0, INDEX_MODULUS - 1),)),
    "H": CommandSpec("externally triggered pings: 0 = passive, 1 = active", ((0, 1),)),
    "J": CommandSpec("external trigger: enable, pin", ((0, 1), (1, 2))),
    "K": CommandSpec("high-voltage amplifier", ((0, 1),)),
    "A": CommandSpec("ping now: 0 = passive, 1 = active", ((0, 1),)),
}


def encode_command(letter: str, *args: int) -> bytes:
    r"""One command line.

    >>> encode_command("C", 7, 2048)
    b'!C,7,2048,0\n'

    Raises
    ------
    SettingsError
        If the letter is unknown, or an argument is missing or out of its range.
    """
    spec = COMMANDS.get(letter)
    if spec is None:
        raise SettingsError(f"command {letter!r}, expected one of {' '.join(COMMANDS)}")
    if len(args) != len(spec.ranges):
        raise SettingsError(
            f"command {letter} ({spec.meaning}) with {len(args)} arguments, "
            f"expected {len(spec.ranges)}"
        )
    for value, (low, high) in zip(args, spec.ranges, strict=True):
        if not low <= value <= high:
            raise SettingsError(
                f"command {letter} ({spec.meaning}): {value}, expected {low} to {high}"
            )
    # The incumbent's Linux client sends J with two fields more than the others; so do we.
    fields = 5 if letter == "J" else 3
    values = [*args, 0, 0, 0, 0, 0][: fields - 1 if letter == "J" else fields]
    return f"!{letter},{','.join(str(int(value)) for value in values)}\n".encode()


def encode_frame_size(num_words: int) -> bytes:
    """Ask for frames of ``num_words`` PDM words; the wire wants bytes.

    Raises
    ------
    SettingsError
        If it is not a multiple of 32768 words in range.
    """
    if num_words % WORDS_STEP:
        raise SettingsError(f"num_words {num_words}, expected a multiple of {WORDS_STEP}")
    return encode_command("G", 4 * num_words)


def encode_trigger(*, active: bool, form: TriggerForm = "linux") -> bytes:
    """Ping now.

    The incumbent's two clients disagree: the Windows one sends the opposite flag and no newline.
    """
    if form == "windows":
        return b"!A,0,0,0" if active else b"!A,1,0,0"
    return encode_command("A", int(active))


def decode_reply(data: Bytes) -> int:
    """Read the 32-bit word of a four-byte reply."""
    (word,) = struct.unpack("<I", data)
    return int(word)


def encode_reply(word: int) -> bytes:
    """Make a four-byte reply."""
    return struct.pack("<I", word % INDEX_MODULUS)


def parse_firmware(word: int) -> str:
    """Read the version in a version word.

    >>> parse_firmware(131844)
    '2.3.4'
    """
    return f"{word >> 16 & 0xFF}.{word >> 8 & 0xFF}.{word & 0xFF}"


def parse_source(word: int) -> Source:
    """Who answers, from the top byte of a version word.

    Raises
    ------
    WrongDevice
        If that byte is neither 0 (hardware) nor a mark of our emulator.
    """
    source = SOURCE_MARKS.get(word >> 24)
    if source is None:
        raise WrongDevice(f"version word 0x{word:08x} is no eRTIS's, expected 0x00 in its top byte")
    return source


def encode_version(firmware: str, source: Source = "live") -> int:
    """Make the version word of a ``major.minor.bugfix`` that marks itself as ``source``."""
    major, minor, bugfix = (int(part) for part in firmware.split("."))
    mark = next(mark for mark, name in SOURCE_MARKS.items() if name == source)
    return mark << 24 | major << 16 | minor << 8 | bugfix


def chirp_hash(codes: npt.NDArray[np.uint16]) -> int:
    """XOR of the DAC codes, as ``L`` replies. Blind to order: it proves nothing alone."""
    return int(np.bitwise_xor.reduce(codes.astype(np.uint32), initial=0))


@dataclass(frozen=True, slots=True, eq=False)
class RawFrame:
    """One frame off the wire.

    index : int
        The device's ping counter, modulo 2**32.
    words : uint32, shape (num_words,)
        PDM words.
    """

    index: int
    words: npt.NDArray[np.uint32]


def frame_bytes(num_words: int) -> int:
    """Length of a frame on the wire, bytes."""
    return 4 * num_words + FRAME_OVERHEAD_BYTES


def encode_frame(index: int, words: npt.NDArray[np.uint32]) -> bytes:
    """Make a frame as the firmware sends it; ``words`` is uint32, shape (num_words,)."""
    payload = np.ascontiguousarray(words, dtype="<u4").tobytes()
    return HEADER_BYTES + encode_reply(index) + payload + FOOTER_BYTES


def decode_frame(data: Bytes) -> RawFrame:
    """Read exactly one whole frame, of any number of words.

    Raises
    ------
    FrameCorrupt
        If length, header or footer is wrong.
    """
    if len(data) <= FRAME_OVERHEAD_BYTES or len(data) % 4:
        raise FrameCorrupt(f"frame of {len(data)} bytes, expected 12 + 4 n")
    if bytes(data[:4]) != HEADER_BYTES or bytes(data[-4:]) != FOOTER_BYTES:
        raise FrameCorrupt(
            f"frame between {bytes(data[:4]).hex()} and {bytes(data[-4:]).hex()}, "
            f"expected {HEADER_BYTES.hex()} and {FOOTER_BYTES.hex()}"
        )
    count = (len(data) - FRAME_OVERHEAD_BYTES) // 4
    words = np.frombuffer(data, dtype="<u4", count=count, offset=8).astype(np.uint32)
    return RawFrame(decode_reply(data[4:8]), words)
