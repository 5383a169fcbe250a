"""The acquisition thread: ping, and hand over what was heard."""

from __future__ import annotations

import logging
import threading
import time

from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.status import Status
from ertis_driver.device import Sonar
from ertis_driver.errors import DeviceTimeout, EndOfRecording, FrameCorrupt, PingLost
from ertis_driver.frame import PdmFrame
from ertis_driver.ping_counter import missing_between

log = logging.getLogger(__name__)

MAX_TIMEOUTS = 5  # in a row; a sonar silent for longer is not coming back by itself


class Acquisition(threading.Thread):
    """Pings a sonar until told to stop, until it fails, or until enough was heard.

    Parameters
    ----------
    sonar
        Configured.
    queue
        Where frames go; it is ended when there will be no more, with the error if there was one.
    status
        ``pings_heard``, ``pings_lost``, ``pings_away``, ``frames_corrupt`` and ``timeouts`` are
        counted here.
    ping_rate_hz
        0 for as fast as it goes.
    max_pings
        Frames to hear; 0 for no end.
    """

    def __init__(
        self,
        sonar: Sonar,
        queue: FrameQueue,
        status: Status,
        stop: threading.Event,
        *,
        ping_rate_hz: float = 0.0,
        max_pings: int = 0,
    ) -> None:
        super().__init__(name="acquisition", daemon=True)
        self._sonar = sonar
        self._queue = queue
        self._status = status
        self._stop_event = stop
        self._period_s = 1.0 / ping_rate_hz if ping_rate_hz else 0.0
        self._max_pings = max_pings
        self._last_index: int | None = None
        self._silent = 0

    def run(self) -> None:
        """Ping until there is a reason to end, and hand that reason over."""
        try:
            self._ping_on()
        except EndOfRecording:
            self._queue.end()
        except BaseException as error:  # noqa: BLE001  # the loop raises it
            self._queue.end(error)
        else:
            self._queue.end()

    def _ping_on(self) -> None:
        due_s = time.monotonic()
        while not self._stop_event.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + self._period_s, time.monotonic())  # no burst after a stall
            frame = self._ping_once()
            if frame is None:
                continue
            self._queue.put(HeardPing(frame, time.monotonic()))
            self._status.queue_drops = self._queue.drops
            if self._status.pings_heard == self._max_pings:
                return

    def _ping_once(self) -> PdmFrame | None:
        try:
            frame = self._sonar.ping()
        except FrameCorrupt as error:
            self._status.frames_corrupt += 1
            log.warning("the frame after ping %s was dropped: %s", self._last_index, error)
            return None
        except PingLost as error:
            self._status.pings_away += 1
            self._silent = 0
            log.debug("no frame after ping %s: %s", self._last_index, error)
            return None
        except DeviceTimeout as error:
            self._status.timeouts += 1
            self._silent += 1
            if self._silent > MAX_TIMEOUTS:
                raise
            log.warning("no frame after ping %s: %s", self._last_index, error)
            return None
        self._silent = 0
        self._count(frame.ping_index)
        return frame

    def _count(self, index: int) -> None:
        self._status.pings_heard += 1
        if self._last_index is not None:
            self._status.pings_lost += missing_between(self._last_index, index)
        self._last_index = index
