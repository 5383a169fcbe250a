"""Sonars that would hear each other ping one after the other."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

FADE_S = 0.015  # after listening: echoes of 6 to 9 m, which would be heard as near ones
PATIENCE_S = 0.25  # beyond listening, for a ping that does not end; then the air is anybody's
POLL_S = 0.05


class Turns:
    """The air between some sonars, first come, first served.

    Whoever had it queues behind all that wait, so that each gets its turn. A sonar that keeps it
    for longer than its ping can last (it is silent, or was unplugged) loses it: its chirp is out
    by then, or never comes.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: deque[object] = deque()
        self._holder: object | None = None
        self._free_s = 0.0  # when it is quiet again, at the latest

    @contextmanager
    def turn(self, listening_s: float, stopped: Callable[[], bool]) -> Iterator[bool]:
        """Wait for the air and keep it for one ping.

        Parameters
        ----------
        listening_s
            How long the ping listens, s.
        stopped
            Whether to give up waiting.

        Yields
        ------
        bool
            Whether it is ours; False only if stopped.
        """
        ticket = object()
        ours = self._take(ticket, listening_s, stopped)
        started_s = time.monotonic()
        try:
            yield ours
        finally:
            if ours:
                self._give(ticket, started_s + listening_s + FADE_S)

    def _take(self, ticket: object, listening_s: float, stopped: Callable[[], bool]) -> bool:
        with self._changed:
            self._waiting.append(ticket)
            try:
                while not stopped():
                    left_s = self._free_s - time.monotonic()
                    if self._waiting[0] is ticket and left_s <= 0:
                        self._holder = ticket
                        self._free_s = time.monotonic() + listening_s + PATIENCE_S
                        return True
                    self._changed.wait(min(max(left_s, 1e-3), POLL_S))
                return False
            finally:
                self._waiting.remove(ticket)
                self._changed.notify_all()

    def _give(self, ticket: object, quiet_s: float) -> None:
        with self._changed:
            if self._holder is ticket:
                self._holder = None
                self._free_s = quiet_s
                self._changed.notify_all()
