"""A recording session: ping after ping from a sonar into a file, until there is a reason to end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from ertis_daemon.recordings.looking import Look, Looker, name_faulty
from ertis_driver.device import Sonar
from ertis_driver.errors import (
    DeviceTimeout,
    DiskFull,
    EndOfRecording,
    ErtisError,
    FrameCorrupt,
    PingLost,
)
from ertis_driver.frame import PdmFrame
from ertis_driver.ping_counter import missing_between
from ertis_driver.recording import RecordingWriter
from ertis_driver.split_recording import SplitRecording

LOOK_PERIOD_S = 0.2  # five pings a second are looked at, however fast they come
MAX_TIMEOUTS = 5  # in a row; a sonar silent for longer is not coming back by itself

Reason = Literal["asked", "stopped", "end of the recording played", "disk full", "failed"]


@dataclass(slots=True)
class SessionReport:
    """What came of it.

    pings_lost : int
        Gaps in the device's counter, whatever the reason.
    pings_failed : int
        Asked for and not delivered: corrupt, late, or while the sonar was away.
    error : str
        What the sonar or the disk said, or empty.
    """

    pings: int = 0
    pings_lost: int = 0
    pings_failed: int = 0
    seconds: float = 0.0
    ended: Reason = "asked"
    error: str = ""
    look: Look | None = None

    @property
    def is_complete(self) -> bool:
        """Nothing was lost."""
        return self.ended not in ("disk full", "failed") and not (
            self.pings_lost or self.pings_failed
        )

    def disk_full(self, error: DiskFull) -> None:
        """It ended so; the file stays."""
        kept = "; what was written before is kept and readable" if self.pings else ""
        self.ended, self.error = "disk full", f"{error}{kept}"


class Session:
    """Records.

    Parameters
    ----------
    sonar
        Configured.
    writer
        Where pings go; closed by whoever made it.
    stop
        Set it to end.
    looker
        What looks at pings; None looks at none.
    max_pings, max_s
        0 for no end.
    rate_hz
        0 for as fast as it goes.
    active
        Emit the chirp; False only listens.
    progress
        Called after each ping.
    """

    def __init__(
        self,
        sonar: Sonar,
        writer: RecordingWriter | SplitRecording,
        stop: threading.Event,
        *,
        looker: Looker | None = None,
        max_pings: int = 0,
        max_s: float = 0.0,
        rate_hz: float = 0.0,
        active: bool = True,
        progress: Callable[[SessionReport], None] = lambda report: None,
    ) -> None:
        self.report = SessionReport()
        self._sonar, self._writer, self._stop, self._looker = sonar, writer, stop, looker
        self._max_pings, self._max_s = max_pings, max_s
        self._period_s = 1 / rate_hz if rate_hz else 0.0
        self._active, self._progress = active, progress
        self._last_index: int | None = None
        self._silent = 0
        self._look_due_s = 0.0
        self._said: set[tuple[int, str]] = set()

    def run(self) -> SessionReport:
        """Record until enough, stopped, or stopped by sonar or disk; what is written stays."""
        report, started_s = self.report, time.monotonic()
        due_s = started_s
        try:
            while not self._stop.wait(max(0.0, due_s - time.monotonic())):
                due_s = max(due_s + self._period_s, time.monotonic())
                self._ping_once()
                report.seconds = time.monotonic() - started_s
                self._progress(report)
                if self._max_pings and report.pings >= self._max_pings:
                    break
                if self._max_s and report.seconds >= self._max_s:
                    break
            else:
                report.ended = "stopped"
        except EndOfRecording:
            report.ended = "end of the recording played"
        except DiskFull as error:
            report.disk_full(error)
        except ErtisError as error:
            report.ended, report.error = "failed", str(error)
        report.seconds = time.monotonic() - started_s
        return report

    def _ping_once(self) -> None:
        try:
            frame = self._sonar.ping(active=self._active)
        except (FrameCorrupt, PingLost, DeviceTimeout) as error:
            self._silent += isinstance(error, DeviceTimeout)
            self.report.pings_failed += 1
            self._log("WARNING", str(error), time.time_ns())
            if self._silent > MAX_TIMEOUTS:
                raise
            return
        self._silent = 0
        lost = (
            0 if self._last_index is None else missing_between(self._last_index, frame.ping_index)
        )
        self._last_index = frame.ping_index
        self._writer.write(frame)
        self.report.pings += 1
        if lost:
            self.report.pings_lost += lost
            self._log("WARNING", f"{lost} pings lost before {frame.ping_index}", frame.ping_time_ns)
        if self._looker is not None and time.monotonic() >= self._look_due_s:
            self._look_due_s = time.monotonic() + LOOK_PERIOD_S
            self._look(self._looker, frame)

    def _look(self, looker: Looker, frame: PdmFrame) -> None:
        look = looker.look(frame)
        if look is None:
            return
        self.report.look = look
        if look.picture:
            self._writer.write_picture(look.picture, frame.ping_time_ns)
        news = [fault for fault in look.faulty if fault not in self._said]
        if news:
            self._said.update(news)
            self._log("WARNING", name_faulty(news), frame.ping_time_ns)

    def _log(self, level: str, message: str, time_ns: int) -> None:
        self._writer.write_log(level, message, time_ns)
