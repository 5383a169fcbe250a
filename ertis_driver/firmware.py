"""What the firmware does, as far as a client can see: command bytes in, reply bytes out. Pure."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ertis_driver import protocol
from ertis_driver.chirp import DAC_IDLE_CODE, MAX_DAC_SAMPLES
from ertis_driver.device import WORDS_STEP
from ertis_driver.errors import ErtisError
from ertis_driver.frame import DEFAULT_NUM_WORDS, Source

log = logging.getLogger(__name__)

LINE = re.compile(rb"!([A-Z])((?:,\d{1,10}){3,5})\r?$")
MAX_LINE_BYTES = 256  # longer ones are noise; do not hoard it


@dataclass(frozen=True, slots=True, eq=False)
class PingRequest:
    """One ping, as the client set it up.

    index : int
        The device's ping counter.
    num_words : int
        PDM words asked for.
    dac_codes : uint16, shape (n,), read-only
        The chirp as uploaded, 12 bits, idle 2048.
    dac_rate_hz : int
        Rate at which it is played, Hz.
    active : bool
        Whether it is emitted at all.
    """

    index: int
    num_words: int
    dac_codes: npt.NDArray[np.uint16]
    dac_rate_hz: int
    active: bool


class FrameSource(Protocol):
    """Makes the frames of an emulated sonar."""

    def next_frame(self, request: PingRequest) -> npt.NDArray[np.uint32]:
        """Return what the microphones hear: uint32, shape (request.num_words,).

        Raises
        ------
        ErtisError
            If it cannot: the emulator logs it and stays silent, as broken hardware would.
        """


class FirmwareState:
    """The registers and the command interpreter; knows no port.

    Parameters
    ----------
    source
        Makes the frames.
    mark
        What the version word says about who answers.
    firmware
        Version, ``major.minor.bugfix``.
    """

    def __init__(
        self, source: FrameSource, *, mark: Source = "sim", firmware: str = "2.3.4"
    ) -> None:
        self._source = source
        self._version = protocol.encode_version(firmware, mark)
        self._line = bytearray()
        self._dac_codes = np.full(MAX_DAC_SAMPLES, DAC_IDLE_CODE, np.uint16)
        self._held = {"G": 4 * DEFAULT_NUM_WORDS, "F": 0, "D": 450_000, "E": 1126, "I": 1, "H": 0}
        self.ping_index = 0
        self.garbage_lines = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes as they come; return the replies to the commands that they complete."""
        replies: list[bytes] = []
        *lines, rest = (bytes(self._line) + data).split(b"\n")
        self._line = bytearray(rest[-MAX_LINE_BYTES:])
        for line in lines:
            # What stands before the mark is noise on the line.
            found = LINE.match(line, max(0, line.rfind(b"!")))
            if found is None:
                self.garbage_lines += 1
                log.debug("ignored %r", line)
                continue
            args = [int(field) for field in found[2].split(b",")[1:]]
            reply = self._execute(found[1].decode(), args)
            if reply is not None:
                replies.append(reply)
        return replies

    def _execute(self, letter: str, args: list[int]) -> bytes | None:
        if letter == "A":
            return self._ping(active=args[0] == 1)
        spec = protocol.COMMANDS.get(letter)
        if spec is None:
            self.garbage_lines += 1
            return None
        for value, (low, high) in zip(args, spec.ranges, strict=False):
            if not low <= value <= high:
                log.warning("!%s with %d, expected %d to %d: ignored", letter, value, low, high)
                return protocol.encode_reply(self._held.get(letter, 0))
        return protocol.encode_reply(self._set(letter, args))

    def _set(self, letter: str, args: list[int]) -> int:
        value = args[0]
        if letter == "Y":
            return self._version
        if letter == "L":
            return protocol.chirp_hash(self._dac_codes[: self._held["E"]])
        if letter == "C":
            self._dac_codes[value] = args[1]
            return args[1]
        if letter == "B":
            self.ping_index = value
            return value
        if letter in "JK" or (letter == "F" and value):
            log.info("!%s,%d is not emulated", letter, value)
            return 0  # which says so
        if letter == "G" and value % (4 * WORDS_STEP):
            log.warning("!G with %d, expected a multiple of %d", value, 4 * WORDS_STEP)
            return self._held["G"]
        self._held[letter] = value
        return value

    def _ping(self, *, active: bool) -> bytes | None:
        codes = self._dac_codes[: self._held["E"]].copy()
        codes.setflags(write=False)
        index = self.ping_index
        self.ping_index = (index + 1) % protocol.INDEX_MODULUS
        request = PingRequest(index, self._held["G"] // 4, codes, self._held["D"], active)
        try:
            words = self._source.next_frame(request)
        except ErtisError as error:
            log.error("ping %d: no frame: %s", index, error)
            return None
        if words.shape != (request.num_words,):
            log.error("ping %d: %s words, expected %d", index, words.shape, request.num_words)
            return None
        return protocol.encode_frame(index, words)
