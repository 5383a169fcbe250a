"""A recording as a device, as fast as it goes or in real time."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from urllib.parse import parse_qsl

from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.errors import (
    AddressError,
    DeviceLost,
    DeviceTimeout,
    EndOfRecording,
    NotConfigured,
)
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import Recording, open_recording
from ertis_driver.replay_pace import ReplayPace

log = logging.getLogger(__name__)


class ReplayDevice(Closing):
    """Plays a recording; implements ``Sonar``.

    What was recorded stays as it was: times, indices, active flags and settings. ``ping`` takes
    the next ping whatever ``active`` says; the frame's own flag is true.

    Parameters
    ----------
    path
        An MCAP recording, or headerless uint32 words.
    rate : float or None
        1 keeps the recording's own pace, 2 plays it twice as fast; None as fast as it goes.
    loop
        Begin again after the last ping; ping times go on.
    address
        What the user called it; ``replay:path`` if not given.

    Raises
    ------
    RecordingError
        If it is neither.
    SettingsError
        If there is no such rate.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        rate: float | None = None,
        loop: bool = False,
        address: str | None = None,
    ) -> None:
        self._recording = open_recording(path)
        self._pace: ReplayPace | None = ReplayPace(self._recording, rate=rate, loop=loop)
        self._closed = threading.Event()
        self._configured = False
        recorded = self._recording.info
        self._settings = (
            Settings(recorded.chirp, recorded.num_words, recorded.pdm_rate_hz)
            if recorded.chirp is not None
            else None
        )
        self._info = DeviceInfo(
            address=f"replay:{path}" if address is None else address,
            source="sim" if recorded.source == "sim" else "replay",
            firmware=recorded.firmware,
        )

    @property
    def info(self) -> DeviceInfo:
        """Source ``sim`` if a simulation was recorded, else ``replay``."""
        return self._info

    @property
    def recording(self) -> Recording:
        """What is played."""
        return self._recording

    @property
    def settings(self) -> Settings | None:
        """The recording's own; for one that knows no chirp, None before ``configure``."""
        return self._settings

    @property
    def is_live(self) -> bool:
        """Never."""
        return False

    def configure(self, settings: Settings) -> None:
        """Accept settings; what is recorded keeps its own."""
        if self._settings is None:
            recorded = self._recording.info
            self._settings = Settings(settings.chirp, recorded.num_words, recorded.pdm_rate_hz)
        if settings != self._settings:
            log.warning(
                "%s keeps its own settings (%s, %d words); asked for %s, %d words",
                self._recording.path,
                self._settings.chirp.name,
                self._settings.num_words,
                settings.chirp.name,
                settings.num_words,
            )
        self._configured = True

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Return the next recorded ping, whatever ``active`` says.

        Raises
        ------
        NotConfigured
            Before ``configure``.
        EndOfRecording
            After the last ping.
        RecordingError
            Where the recording is damaged.
        DeviceLost
            After ``close``.
        """
        return self._next(None)

    def wait_frame(self, timeout_s: float) -> PdmFrame:
        """Return the next recorded ping: a recording needs no trigger.

        Raises
        ------
        DeviceTimeout
            If, in real time, it is not due by then.
        NotConfigured, EndOfRecording, RecordingError, DeviceLost
            As ``ping``.
        """
        return self._next(timeout_s)

    def close(self) -> None:
        """End it, also a wait in another thread. May be called twice."""
        self._closed.set()
        self._pace = None
        self._configured = False

    def _next(self, timeout_s: float | None) -> PdmFrame:
        pace = self._pace
        if pace is None:
            raise DeviceLost(f"{self._info.address} is closed: reopen it")
        if not self._configured:
            raise NotConfigured(f"{self._info.address} is not configured: configure it first")
        left_s = pace.left_s()
        if timeout_s is not None and left_s > timeout_s:
            self._closed.wait(timeout_s)
            raise DeviceTimeout(
                f"{self._info.address}: the next ping is due in {left_s:.1f} s, after "
                f"{timeout_s:g} s: wait again"
            )
        ping = pace.wait(self._closed)
        if self._closed.is_set():
            raise DeviceLost(f"{self._info.address} was closed: reopen it")
        if ping is None:
            raise EndOfRecording(f"{self._recording.path} has no more pings")
        return ping.frame


def open_replay(where: str, *, rate: float | None = None, loop: bool = False) -> ReplayDevice:
    """Open a recording as a device.

    Parameters
    ----------
    where
        A file; after a question mark, ``rate=2`` plays it in twice its own pace instead of as fast
        as it goes, and ``loop=1`` over and over: ``garage.mcap?rate=1&loop=1``.
    rate, loop
        If ``where`` does not say.

    Raises
    ------
    AddressError
        If another option is asked for.
    RecordingError
        If it cannot be read.
    """
    address = f"replay:{where}"
    path, mark, text = where.rpartition("?")
    if not mark or Path(where).exists():
        return ReplayDevice(where, rate=rate, loop=loop, address=address)
    options = dict(parse_qsl(text, keep_blank_values=True))
    try:
        rate = float(options.pop("rate")) if "rate" in options else rate
        loop = {"1": True, "0": False}[options.pop("loop", str(int(loop)))]
    except (ValueError, KeyError) as error:
        raise AddressError(
            f"{address}: {error}, expected rate=NUMBER and loop=1, with & between"
        ) from error
    if options:
        raise AddressError(f"{address}: unknown option {', '.join(options)}, expected rate or loop")
    return ReplayDevice(path, rate=rate, loop=loop, address=address)
