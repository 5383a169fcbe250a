"""What every sonar can do, whoever is behind it."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol

from typing_extensions import Self

from ertis_driver.chirp import DEFAULT_CHIRP, Emission
from ertis_driver.errors import SettingsError
from ertis_driver.frame import (
    AUDIBLE_PDM_RATE_HZ,
    DEFAULT_NUM_WORDS,
    PDM_RATE_HZ,
    PdmFrame,
    Source,
)

WORDS_STEP = 32_768  # the firmware takes whole multiples only
MAX_NUM_WORDS = 16_777_216  # at 4.5 MHz; no other limit is known for 1.125 MHz
MAX_EMISSIONS = 65_535
MAX_PING_INDEX = 2**32 - 1
PDM_RATES_HZ = (PDM_RATE_HZ, AUDIBLE_PDM_RATE_HZ)
TRIGGER_PINS = (1, 2)


@dataclass(frozen=True, slots=True)
class ExternalTrigger:
    """An edge on a pin makes the device ping, unasked.

    pin : int
        1 or 2.
    active : bool
        Emit the chirp; False only listens.

    Raises
    ------
    SettingsError
        If there is no such pin.
    """

    pin: int = 1
    active: bool = True

    def __post_init__(self) -> None:
        if self.pin not in TRIGGER_PINS:
            raise SettingsError(f"external trigger on pin {self.pin}, expected 1 or 2")


@dataclass(frozen=True, slots=True)
class Settings:
    """How to ping and for how long to listen.

    chirp : Chirp or CustomChirp
        What is emitted.
    num_words : int
        PDM words to listen for, a multiple of 32768.
    pdm_rate_hz : int
        4,500,000 (ultrasound), or 1,125,000 (audible): the same words last four times as long,
        and sound above 56 kHz is lost.
    emissions : int
        How often the chirp is emitted in one ping.
    first_ping_index : int or None
        Where the device's ping counter begins; None leaves it as it is.
    amplifier : bool or None
        High-voltage amplifier for a louder chirp. None: on where the firmware has one, as the
        incumbent's client does.
    external_trigger : ExternalTrigger or None
        What pings; None: ``Sonar.ping`` does.

    Raises
    ------
    SettingsError
        If the device would not accept them.
    """

    chirp: Emission = field(default_factory=lambda: DEFAULT_CHIRP)
    num_words: int = DEFAULT_NUM_WORDS
    pdm_rate_hz: int = PDM_RATE_HZ
    emissions: int = 1
    first_ping_index: int | None = None
    amplifier: bool | None = None
    external_trigger: ExternalTrigger | None = None

    def __post_init__(self) -> None:
        whole = isinstance(self.num_words, int) and self.num_words % WORDS_STEP == 0
        if not (whole and 0 < self.num_words <= MAX_NUM_WORDS):
            raise SettingsError(
                f"num_words {self.num_words}, expected a multiple of {WORDS_STEP} up to "
                f"{MAX_NUM_WORDS}; 163840 listens for 36.4 ms (6.2 m)"
            )
        if self.pdm_rate_hz not in PDM_RATES_HZ:
            raise SettingsError(
                f"PDM clock {self.pdm_rate_hz} Hz, expected {PDM_RATE_HZ} (ultrasound) or "
                f"{AUDIBLE_PDM_RATE_HZ} (audible): the device has no other"
            )
        _check("emissions", self.emissions, 1, MAX_EMISSIONS)
        if self.first_ping_index is not None:
            _check("first_ping_index", self.first_ping_index, 0, MAX_PING_INDEX)

    @property
    def listening_s(self) -> float:
        """How long one ping listens, s."""
        return self.num_words / self.pdm_rate_hz


def _check(name: str, value: int, low: int, high: int) -> None:
    if not isinstance(value, int) or not low <= value <= high:
        raise SettingsError(f"{name} {value!r}, expected a whole number from {low} to {high}")


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """Who answers.

    address : str
        What ``open_device`` was given.
    firmware : str
        Version as ``major.minor.bugfix``, or empty if there is none.
    source : str
        ``live`` for hardware, ``replay`` for a recording, ``sim`` for a simulated world.
    """

    address: str
    source: Source
    firmware: str = ""


class Sonar(Protocol):
    """A sonar: configure it, ping it, close it. Also a context manager."""

    @property
    def info(self) -> DeviceInfo:
        """Who answers."""

    @property
    def settings(self) -> Settings | None:
        """What it is configured to do; None before ``configure``."""

    @property
    def is_live(self) -> bool:
        """Whether a real device made the frames."""

    def configure(self, settings: Settings) -> None:
        """Make the device ready to ping.

        Raises
        ------
        DeviceUnsupported
            If it has no amplifier or external trigger, and one was asked for.
        DeviceError
            If it does not answer as it should. It then counts as unconfigured.
        """

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Emit one chirp (or none, if not ``active``) and return what was heard.

        Raises
        ------
        NotConfigured
            Also if an external trigger is set: ``wait_frame`` is for that.
        DeviceTimeout, DeviceLost, FrameCorrupt, EndOfRecording
        """

    def wait_frame(self, timeout_s: float) -> PdmFrame:
        """Return the next frame that an external trigger makes the device send.

        Parameters
        ----------
        timeout_s
            Patience for a frame to begin, s.

        Raises
        ------
        NotConfigured
            If no external trigger is set.
        DeviceTimeout
            If no frame began in time.
        DeviceLost, FrameCorrupt, EndOfRecording
        """

    def close(self) -> None:
        """Give the device back. May be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...
