"""The acquisition thread: ping, and hand over what was heard."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from ertis_daemon.config import PingOn
from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.status import Status
from ertis_daemon.turns import Turns
from ertis_driver.device import Sonar
from ertis_driver.errors import DeviceTimeout, EndOfRecording, FrameCorrupt, PingLost
from ertis_driver.frame import PdmFrame
from ertis_driver.ping_counter import missing_between

log = logging.getLogger(__name__)

MAX_TIMEOUTS = 5  # in a row; a sonar silent for longer is not coming back by itself
MAX_DAMAGED = 10  # frames in a row; a sonar that restarted may send them in another size for ever
EDGE_WAIT_S = 0.2  # for a trigger; how late a stop is seen
POLL_S = 0.1
MAX_ASKED = 100  # pings on demand that may wait


def _nothing(frame: PdmFrame) -> None: ...


class PingRequests:
    """Pings asked for one by one; more than 100 are refused."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._asked = 0

    def ask(self, count: int) -> int:
        """Ask for pings; returns how many wait now, which may be all there is room for."""
        with self._changed:
            self._asked = min(self._asked + count, MAX_ASKED)
            self._changed.notify_all()
            return self._asked

    def take(self, timeout_s: float) -> bool:
        """Whether a ping was asked for in time; it is taken off."""
        with self._changed:
            if not self._asked:
                self._changed.wait(timeout_s)
            if not self._asked:
                return False
            self._asked -= 1
            return True


@dataclass(frozen=True, slots=True)
class Pace:
    """When to ping.

    ping_on : str
        ``timer``, ``pin1``, ``pin2`` or ``command``.
    ping_rate_hz : float
        Of the timer; 0 for as fast as it goes.
    max_pings : int
        Frames to hear; 0 for no end.
    turns : Turns or None
        Shared with the sonars that would hear this one.
    requests : PingRequests
        Where pings on ``command`` are asked for.
    """

    ping_on: PingOn = "timer"
    ping_rate_hz: float = 0.0
    max_pings: int = 0
    turns: Turns | None = None
    requests: PingRequests = field(default_factory=PingRequests)


class Acquisition(threading.Thread):
    """Pings a sonar until told to stop, until it fails, or until enough was heard.

    Parameters
    ----------
    sonar
        Configured.
    queue
        Where frames go; it is ended when there will be no more, with the error if there was one.
    status
        ``pings_heard``, ``pings_lost``, ``pings_away``, ``frames_corrupt``, ``timeouts`` and
        ``clock_steps`` are counted here.
    pace
        When to ping.
    heard
        Called with each frame; must return at once.

    Attributes
    ----------
    sign_of_life_s : float
        When the sonar last let this thread go, monotonic s. A driver that hangs is seen by it.
    """

    def __init__(
        self,
        sonar: Sonar,
        queue: FrameQueue,
        status: Status,
        stop: threading.Event,
        pace: Pace,
        heard: Callable[[PdmFrame], None] = _nothing,
    ) -> None:
        super().__init__(name="acquisition", daemon=True)
        self._sonar = sonar
        self._queue = queue
        self._status = status
        self._stop_event = stop
        self._pace = pace
        self._period_s = 1.0 / pace.ping_rate_hz if pace.ping_rate_hz else 0.0
        self._due_s = time.monotonic()
        self._heard = heard
        self._last_index: int | None = None
        self._count = 0
        self._silent = 0
        self._damaged = 0
        self.sign_of_life_s = time.monotonic()

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
        self._due_s = time.monotonic()
        while not self._stop_event.is_set():
            frame = self._ping_once() if self._is_time() else None
            self.sign_of_life_s = time.monotonic()
            if frame is None:
                continue
            self._note(frame)
            self._queue.put(HeardPing(frame, self.sign_of_life_s))
            self._status.queue_drops += self._queue.take_drops()
            if self._count == self._pace.max_pings:
                return

    def _is_time(self) -> bool:
        if self._pace.ping_on == "command":
            return self._pace.requests.take(POLL_S)
        if self._pace.ping_on != "timer":
            return True
        left_s = self._due_s - time.monotonic()
        if left_s > POLL_S:
            self._stop_event.wait(POLL_S)
            return False
        if self._stop_event.wait(max(0.0, left_s)):
            return False
        now_s = time.monotonic()
        self._due_s += self._period_s
        if self._due_s < now_s:  # after a stall: one ping at once, and none in a burst after it
            self._due_s = now_s + self._period_s
        return True

    def _ping_once(self) -> PdmFrame | None:
        try:
            frame = self._frame()
        except FrameCorrupt as error:
            self._status.frames_corrupt += 1
            self._damaged += 1
            if self._damaged > MAX_DAMAGED:
                raise
            log.warning("the frame after ping %s was dropped: %s", self._last_index, error)
            return None
        except PingLost as error:
            self._status.pings_away += 1
            self._status.state = "away"
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
        self._silent = self._damaged = 0
        return frame

    def _frame(self) -> PdmFrame | None:
        if self._pace.ping_on in ("pin1", "pin2"):
            return self._triggered()
        if self._pace.turns is None:
            return self._sonar.ping()
        # Looked for without the air: a sonar that is away must not keep it from the others.
        find = getattr(self._sonar, "wait_connected", None)
        if find is not None:
            find()
        settings = self._sonar.settings
        listening_s = settings.listening_s if settings else 0.0
        with self._pace.turns.turn(listening_s, self._stop_event.is_set) as ours:
            return self._sonar.ping() if ours else None

    def _triggered(self) -> PdmFrame | None:
        """The next frame of an external trigger; that no edge comes is no fault."""
        try:
            return self._sonar.wait_frame(EDGE_WAIT_S)
        except DeviceTimeout:
            return None

    def _note(self, frame: PdmFrame) -> None:
        self._count += 1
        self._status.pings_heard += 1
        self._status.heard_s.append(time.monotonic())
        self._status.state = "running"
        if self._last_index is not None:
            self._status.pings_lost += missing_between(self._last_index, frame.ping_index)
        self._last_index = frame.ping_index
        if frame.clock_step_ns:
            self._status.clock_steps += 1
        self._heard(frame)
