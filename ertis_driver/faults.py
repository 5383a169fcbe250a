"""What may go wrong between an emulated device and its client: each fault changes one message."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol

import numpy as np

from ertis_driver.errors import SettingsError
from ertis_driver.outbox import HangUp, Mute, Pause, Rubbish, Step
from ertis_driver.protocol import FOOTER, HEADER, INDEX_MODULUS

RUBBISH_BYTES = 65_536

# Inclusive; a fault outside them would be none, or none that a device could have.
RANGES: dict[str, tuple[float, float]] = {
    "count": (1, 10_000_000),
    "mask": (1, 255),
    "seconds": (0.0, math.inf),
    "away": (0.0, math.inf),
    "ever": (0, 1),
    "footer": (0, 1),
    "past_replies": (0, 1),
    "word": (0, 2**32 - 1),
    "by": (-(2**31), 2**31),
}


class Device(Protocol):
    """What of the firmware a fault may reach."""

    ping_index: int

    def reset(self) -> None:
        """Reboot."""

    def ping(self, *, active: bool) -> bytes | None:
        """Make one frame more."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that happens to one message, at one of its bytes.

    byte : int
        Where; negative counts from the end. Beyond the message is its end.

    Raises
    ------
    SettingsError
        If a parameter is out of its range.
    """

    kind: ClassVar[str] = ""
    byte: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            low, high = RANGES.get(field.name, (-math.inf, math.inf))
            value = getattr(self, field.name)
            if not low <= value <= high:
                raise SettingsError(
                    f"fault {self.kind}: {field.name} {value}, expected {low:g} to {high:g}"
                )

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """What is sent instead of ``message``."""
        raise NotImplementedError

    def at(self, message: bytes) -> int:
        """The place of the byte in this message: 0 to its length."""
        place = self.byte + len(message) if self.byte < 0 else self.byte
        return min(max(place, 0), len(message))


@dataclass(frozen=True, slots=True)
class Drop(Fault):
    """``count`` bytes are lost."""

    kind: ClassVar[str] = "drop"
    count: int = 1

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Without them."""
        at = self.at(message)
        return [message[:at] + message[at + self.count :]]


@dataclass(frozen=True, slots=True)
class Double(Fault):
    """``count`` bytes come twice."""

    kind: ClassVar[str] = "double"
    count: int = 1

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """With them again."""
        at = self.at(message)
        return [message[: at + self.count] + message[at:]]


@dataclass(frozen=True, slots=True)
class Insert(Fault):
    """``count`` random bytes come in between, ``seed`` says which."""

    kind: ClassVar[str] = "insert"
    count: int = 1
    seed: int = 0

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """With them in between."""
        at = self.at(message)
        return [message[:at] + rubbish(self.seed, self.count) + message[at:]]


@dataclass(frozen=True, slots=True)
class Flip(Fault):
    """The bits in ``mask`` are inverted in one byte."""

    kind: ClassVar[str] = "flip"
    mask: int = 1

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """With that byte changed."""
        at = self.at(message)
        if at == len(message):
            return [message]
        return [message[:at] + bytes([message[at] ^ self.mask]) + message[at + 1 :]]


@dataclass(frozen=True, slots=True)
class Magic(Fault):
    """The header, or with ``footer=1`` the footer, is another ``word``."""

    kind: ClassVar[str] = "magic"
    footer: int = 0
    word: int = 0xDEADBEEF

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """With that word instead."""
        word = struct.pack("<I", self.word)
        return [message[:-4] + word] if self.footer else [word + message[4:]]


@dataclass(frozen=True, slots=True)
class Stall(Fault):
    """It stops for ``seconds``, then goes on."""

    kind: ClassVar[str] = "stall"
    seconds: float = 2.0

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """In two parts."""
        at = self.at(message)
        return [message[:at], Pause(self.seconds), message[at:]]


@dataclass(frozen=True, slots=True)
class Silent(Fault):
    """Nothing more comes until the next command or, with ``ever=1``, at all."""

    kind: ClassVar[str] = "silent"
    ever: int = 0

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Its beginning."""
        return [message[: self.at(message)], Mute(ever=bool(self.ever))]


@dataclass(frozen=True, slots=True)
class Vanish(Fault):
    """It is unplugged, and plugged in again ``away`` seconds later, if ever."""

    kind: ClassVar[str] = "vanish"
    away: float = math.inf

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Its beginning, then the end."""
        return [message[: self.at(message)], HangUp(self.away)]


@dataclass(frozen=True, slots=True)
class Jump(Fault):
    """The ping counter jumps ``by`` so many after this message."""

    kind: ClassVar[str] = "jump"
    by: int = 1

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """As it was; the next one tells."""
        device.ping_index = (device.ping_index + self.by) % INDEX_MODULUS
        return [message]


@dataclass(frozen=True, slots=True)
class Reset(Fault):
    """It reboots: the rest of the message, the counter and all settings are lost."""

    kind: ClassVar[str] = "reset"

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Its beginning."""
        device.reset()
        return [message[: self.at(message)]]


@dataclass(frozen=True, slots=True)
class Truncate(Fault):
    """It ends early and the frame of one ping more follows at once."""

    kind: ClassVar[str] = "truncate"

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Its beginning and a whole frame."""
        return [message[: self.at(message)], device.ping(active=True) or b""]


@dataclass(frozen=True, slots=True)
class Late(Fault):
    """It does not come until the next reply does or, with ``past_replies=1``, the next frame."""

    kind: ClassVar[str] = "late"
    past_replies: int = 0

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Nothing; the injector keeps it."""
        return []


@dataclass(frozen=True, slots=True)
class Babble(Fault):
    """It stops, and random bytes come for ``seconds`` instead of the rest; ``seed`` says which."""

    kind: ClassVar[str] = "babble"
    seconds: float = math.inf
    seed: int = 0

    def steps(self, message: bytes, device: Device) -> list[Step]:
        """Its beginning and rubbish."""
        block = rubbish(self.seed, RUBBISH_BYTES)
        return [message[: self.at(message)], Rubbish(block, self.seconds)]


_KINDS = (
    *(Drop, Double, Insert, Flip, Magic, Stall, Silent),
    *(Vanish, Jump, Reset, Truncate, Late, Babble),
)
FAULTS: dict[str, type[Fault]] = {fault.kind: fault for fault in _KINDS}


def rubbish(seed: int, count: int) -> bytes:
    """Random bytes that hold a header and a footer here and there, as a sly device would."""
    words = np.random.default_rng(seed).integers(0, 2**32, (count + 3) // 4, dtype=np.uint32)
    words[7::997] = HEADER
    words[500::997] = FOOTER
    return words.astype("<u4").tobytes()[:count]
