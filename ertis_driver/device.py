"""What every sonar can do, whoever is behind it."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol

from typing_extensions import Self

from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
from ertis_driver.errors import SettingsError
from ertis_driver.frame import DEFAULT_NUM_WORDS, PdmFrame, Source

WORDS_STEP = 32_768  # the firmware takes whole multiples only
MAX_NUM_WORDS = 16_777_216


@dataclass(frozen=True, slots=True)
class Settings:
    """How to ping and for how long to listen.

    Raises
    ------
    SettingsError
        If the device would not accept them.
    """

    chirp: Chirp = field(default_factory=lambda: DEFAULT_CHIRP)
    num_words: int = DEFAULT_NUM_WORDS

    def __post_init__(self) -> None:
        if not (0 < self.num_words <= MAX_NUM_WORDS and self.num_words % WORDS_STEP == 0):
            raise SettingsError(
                f"num_words {self.num_words}, expected a multiple of {WORDS_STEP} up to "
                f"{MAX_NUM_WORDS}; 163840 listens for 36.4 ms (6.2 m)"
            )


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
        DeviceError
            If it does not answer as it should; it then counts as unconfigured.
        """

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Emit one chirp (or none, if not ``active``) and return what was heard.

        Raises
        ------
        NotConfigured, DeviceTimeout, DeviceLost, FrameCorrupt, EndOfRecording
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
