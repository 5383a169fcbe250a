"""A short queue between the sonar and the detector: what is stale is dropped and counted."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass, replace

from ertis_driver.frame import PdmFrame


@dataclass(frozen=True, slots=True, eq=False)
class HeardPing:
    """A frame and when it arrived, on the monotonic clock, s."""

    frame: PdmFrame
    arrived_s: float


class FrameQueue:
    """A bounded queue for one producer and one consumer.

    Parameters
    ----------
    size
        Frames that may wait.
    keep_newest
        What to do if it is full: drop the oldest, or let the producer wait.
    """

    def __init__(self, size: int, *, keep_newest: bool) -> None:
        self._drops = 0
        self._dropped_steps_ns = 0
        self._items: deque[HeardPing] = deque()
        self._size = size
        self._keep_newest = keep_newest
        self._ended = False
        self._abandoned = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()

    def put(self, ping: HeardPing) -> None:
        """Hand a ping over."""
        with self._changed:
            while len(self._items) >= self._size and not self._abandoned:
                if self._keep_newest:
                    self._dropped_steps_ns += self._items.popleft().frame.clock_step_ns
                    self._drops += 1
                else:
                    self._changed.wait()
            self._items.append(ping)
            self._changed.notify_all()

    def end(self, error: BaseException | None = None) -> None:
        """Say that no more will come, and why."""
        with self._changed:
            self._ended, self._error = True, error
            self._changed.notify_all()

    def abandon(self) -> None:
        """Say that nobody will take any more: a waiting producer goes on."""
        with self._changed:
            self._abandoned = True
            self._changed.notify_all()

    def get(self, timeout_s: float) -> HeardPing | None:
        """Return the oldest ping waiting; None if there was none in time or none will come.

        Raises
        ------
        BaseException
            What the producer ended with, after its last ping was taken.
        """
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while not self._items:
                left_s = deadline_s - time.monotonic()
                if self._ended or left_s <= 0:
                    break
                self._changed.wait(left_s)
            if self._items:
                ping = self._items.popleft()
                self._changed.notify_all()
                return self._with_dropped_steps(ping)
            if self._error is not None:
                raise self._error
            return None

    def _with_dropped_steps(self, ping: HeardPing) -> HeardPing:
        """The clock was set since the ping taken before, not since one that was dropped."""
        step_ns, self._dropped_steps_ns = self._dropped_steps_ns, 0
        if not step_ns:
            return ping
        step_ns += ping.frame.clock_step_ns
        return replace(ping, frame=replace(ping.frame, clock_step_ns=step_ns))

    def take_drops(self) -> int:
        """How many pings were dropped since this was last asked."""
        with self._changed:
            drops, self._drops = self._drops, 0
            return drops

    @property
    def finished(self) -> bool:
        """Whether all has been taken and no more will come."""
        with self._changed:
            return self._ended and not self._items
