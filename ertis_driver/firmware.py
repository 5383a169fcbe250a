"""What the firmware does, as far as a client can see: command bytes in, reply bytes out. Pure."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ertis_driver import protocol
from ertis_driver.chirp import DAC_IDLE_CODE, MAX_DAC_SAMPLES
from ertis_driver.device import WORDS_STEP
from ertis_driver.errors import ErtisError, SettingsError
from ertis_driver.frame import AUDIBLE_PDM_RATE_HZ, DEFAULT_NUM_WORDS, PDM_RATE_HZ, Source

log = logging.getLogger(__name__)

LINE = re.compile(rb"!([A-Z])((?:,\d{1,10}){3,4})\r?$")  # the Linux client's J has one field more
TRIGGER = re.compile(rb"!A,([01]),0,0")  # the Windows client sends no newline after it
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
    pdm_rate_hz : int
        4,500,000 or 1,125,000.
    emissions : int
        How often the chirp is emitted in this ping.
    amplified : bool
        The high-voltage amplifier is stepped up.
    """

    index: int
    num_words: int
    dac_codes: npt.NDArray[np.uint16]
    dac_rate_hz: int
    active: bool
    pdm_rate_hz: int = PDM_RATE_HZ
    emissions: int = 1
    amplified: bool = False


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
    trigger_form
        What ``A`` means: ``linux``, 1 is active; ``windows``, 0 is active.
    unsupported
        Those of ``J`` (external trigger) and ``K`` (amplifier) that are answered with 0.

    Raises
    ------
    SettingsError
        If ``unsupported`` names another command.
    """

    def __init__(
        self,
        source: FrameSource,
        *,
        mark: Source = "sim",
        firmware: str = "2.3.4",
        trigger_form: protocol.TriggerForm = "linux",
        unsupported: Collection[str] = (),
    ) -> None:
        if not set(unsupported) <= {"J", "K"}:
            raise SettingsError(f"unsupported commands {unsupported!r}, expected some of J, K")
        self._source = source
        self._version = protocol.encode_version(firmware, mark)
        self._active_flag = 0 if trigger_form == "windows" else 1
        self._unsupported = frozenset(unsupported)
        self.garbage_lines = 0
        self.reset()

    def reset(self) -> None:
        """Forget all that was set, counter and chirp too, as at power-on."""
        self._line = b""
        self._after_trigger = False
        self._trigger_pin = 0  # none
        self._dac_codes = np.full(MAX_DAC_SAMPLES, DAC_IDLE_CODE, np.uint16)
        self._held = {"G": 4 * DEFAULT_NUM_WORDS, "F": 0, "D": 450_000, "E": 1126, "I": 1}
        self._held |= {"H": 0, "J": 0, "K": 0}
        self.ping_index = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Take bytes as they come; return the replies to the commands that they complete."""
        replies: list[bytes | None] = []
        text = self._line + data
        while True:
            newline = text.find(b"\n")
            trigger = TRIGGER.search(text, 0, len(text) if newline < 0 else newline)
            if trigger is not None:
                text = text[trigger.end() :]
                self._after_trigger = True
                replies.append(self.ping(active=int(trigger[1]) == self._active_flag))
            elif newline >= 0:
                line, text = text[:newline], text[newline + 1 :]
                replies.append(self._take(line))
                self._after_trigger = False
            else:
                break
        self._line = text[-MAX_LINE_BYTES:]
        return [reply for reply in replies if reply is not None]

    def trigger(self, pin: int) -> bytes | None:
        """Return the frame that an edge on an external trigger pin makes it send unasked.

        Parameters
        ----------
        pin
            1 or 2. Nothing comes of a pin that ``J`` has not enabled.
        """
        if pin != self._trigger_pin:
            return None
        return self.ping(active=self._held["H"] == 1)

    def ping(self, *, active: bool) -> bytes | None:
        """Return the next frame, or None if its source has none; the counter goes on anyway."""
        request = self._request(active=active)
        self.ping_index = (request.index + 1) % protocol.INDEX_MODULUS
        try:
            words = self._source.next_frame(request)
        except ErtisError as error:
            log.error("ping %d: no frame: %s", request.index, error)
            return None
        if words.shape != (request.num_words,):
            log.error(
                "ping %d: %s words, expected %d", request.index, words.shape, request.num_words
            )
            return None
        return protocol.encode_frame(request.index, words)

    def _take(self, line: bytes) -> bytes | None:
        if self._after_trigger and not line.strip():
            return None  # the newline of a trigger that was understood without it
        # What stands before the mark is noise on the line.
        found = LINE.match(line, max(0, line.rfind(b"!")))
        if found is None or found[1] == b"A" or found[1].decode() not in protocol.COMMANDS:
            self.garbage_lines += 1
            log.debug("ignored %r", line)
            return None
        letter = found[1].decode()
        args = [int(field) for field in found[2].split(b",")[1:]]
        for value, (low, high) in zip(args, protocol.COMMANDS[letter].ranges, strict=False):
            # What is disabled needs no pin.
            if not low <= value <= high and not (letter == "J" and args[0] == 0):
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
        if letter in self._unsupported:
            return 0  # which says so
        if letter == "G" and value % (4 * WORDS_STEP):
            log.warning("!G with %d, expected a multiple of %d", value, 4 * WORDS_STEP)
            return self._held["G"]
        if letter == "J":
            self._trigger_pin = args[1] if value else 0
        self._held[letter] = value
        return value

    def _request(self, *, active: bool) -> PingRequest:
        codes = self._dac_codes[: self._held["E"]].copy()
        codes.setflags(write=False)
        return PingRequest(
            index=self.ping_index,
            num_words=self._held["G"] // 4,
            dac_codes=codes,
            dac_rate_hz=self._held["D"],
            active=active,
            pdm_rate_hz=AUDIBLE_PDM_RATE_HZ if self._held["F"] else PDM_RATE_HZ,
            emissions=self._held["I"],
            amplified=self._held["K"] == 1,
        )
