"""A recording as a device, as fast as it goes or in real time."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.errors import DeviceLost, DeviceTimeout, EndOfRecording, NotConfigured
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordedPing, Recording, open_recording

log = logging.getLogger(__name__)


class ReplayDevice(Closing):
    """Plays a recording; implements ``Sonar``.

    What was recorded stays as it was: times, indices, active flags and settings. ``ping`` takes
    the next ping whatever ``active`` says; the frame's own flag is true.

    Parameters
    ----------
    path
        An MCAP recording, or headerless uint32 words.
    realtime
        Keep the recording's own pace instead of the fastest one.
    address
        What the user called it; ``replay:path`` if not given.

    Raises
    ------
    RecordingError
        If it is neither.
    """

    def __init__(
        self, path: str | Path, *, realtime: bool = False, address: str | None = None
    ) -> None:
        self._recording = open_recording(path)
        self._pings: Iterator[RecordedPing] | None = iter(self._recording)
        self._realtime = realtime
        self._start: tuple[float, int] | None = None  # monotonic s, recorded ns
        self._due: RecordedPing | None = None  # read, but its time has not come
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
        self._pings = None
        self._configured = False

    def _next(self, timeout_s: float | None) -> PdmFrame:
        if self._pings is None:
            raise DeviceLost(f"{self._info.address} is closed: reopen it")
        if not self._configured:
            raise NotConfigured(f"{self._info.address} is not configured: configure it first")
        ping = self._due or next(self._pings, None)
        if ping is None:
            raise EndOfRecording(f"{self._recording.path} has no more pings")
        if self._realtime:
            self._due = ping
            self._wait_for(ping.frame.ping_time_ns, timeout_s)
            self._due = None
        return ping.frame

    def _wait_for(self, ping_time_ns: int, timeout_s: float | None) -> None:
        if self._start is None:
            self._start = (time.monotonic(), ping_time_ns)
        started_s, first_ns = self._start
        left_s = max(0.0, started_s + (ping_time_ns - first_ns) / 1e9 - time.monotonic())
        if timeout_s is not None and left_s > timeout_s:
            self._closed.wait(timeout_s)
            raise DeviceTimeout(
                f"{self._info.address}: the next ping is due in {left_s:.1f} s, after "
                f"{timeout_s:g} s: wait again"
            )
        self._closed.wait(left_s)


def open_replay(path: str, *, realtime: bool = False) -> ReplayDevice:
    """Open a recording as a device.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """
    return ReplayDevice(path, realtime=realtime, address=f"replay:{path}")
