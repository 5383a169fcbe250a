"""What an emulated device has yet to send, and when: bytes, pauses, silence, the end."""

from __future__ import annotations

import logging
import math
import os
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

log = logging.getLogger(__name__)

WRITE_BYTES = 65_536
MAX_FRAMES_WAITING = 8  # a device has memory for few; a host that reads none of them is gone

Write = Callable[[bytes | memoryview], int]


@dataclass(frozen=True, slots=True)
class Pause:
    """Send nothing for a while, then go on; what comes later waits behind it.

    seconds : float
    """

    seconds: float


@dataclass(frozen=True, slots=True)
class Mute:
    """Send nothing of this reply any more.

    ever : bool
        Nor of any later one.
    """

    ever: bool = False


@dataclass(frozen=True, slots=True)
class Rubbish:
    """Send the same rubbish over and over, until the time is up.

    block : bytes
    seconds : float
    """

    block: bytes
    seconds: float


@dataclass(frozen=True, slots=True)
class HangUp:
    """Be gone, as if unplugged.

    away_s : float
        Until it is plugged in again, s; infinite if it never is.
    """

    away_s: float = math.inf


Step = bytes | Pause | Mute | Rubbish | HangUp


class Outbox:
    """Steps in their order, carried out as far as the time and the port allow.

    Times are values of ``time.monotonic()``, s. A frame that nobody reads waits, and is dropped
    when the next command arrives: whoever sent that has given it up.
    """

    def __init__(self) -> None:
        self._steps: deque[tuple[Step | memoryview, bool]] = deque()  # with: part of a frame
        self._until_s: float | None = None  # end of the pause or rubbish at the head
        self._muted = False
        self._muted_for_ever = False

    @property
    def is_full(self) -> bool:
        """No room for one frame more."""
        return sum(is_frame for _, is_frame in self._steps) >= MAX_FRAMES_WAITING

    @property
    def wants_to_write(self) -> bool:
        """The port is what it waits for."""
        return bool(self._steps) and not isinstance(self._steps[0][0], Pause)

    def due_in_s(self, now_s: float) -> float:
        """How long a pause at the head still lasts, s; infinite if there is none."""
        if self._steps and isinstance(self._steps[0][0], Pause):
            return max(0.0, self._begin(self._steps[0][0].seconds, now_s) - now_s)
        return math.inf

    def command_came(self) -> None:
        """Whoever sends one is done with what came before, and ends a silence that is not final."""
        self._muted = self._muted_for_ever
        if self._steps and isinstance(self._steps[0][0], memoryview) and self._steps[0][1]:
            log.warning("a command arrived before the frame was read: its rest is dropped")
            self._steps.clear()

    def put(self, steps: Iterable[Step], *, is_frame: bool) -> None:
        """Add a reply."""
        for step in steps:
            if isinstance(step, bytes):
                if step:
                    self._steps.append((memoryview(step), is_frame))
            else:
                self._steps.append((step, is_frame))

    def clear(self) -> None:
        """Forget all of it."""
        self._steps.clear()
        self._until_s = None

    def advance(self, write: Write, now_s: float) -> HangUp | None:
        """Carry out what can be now; ``write`` may raise BlockingIOError.

        Returns
        -------
        HangUp or None
            The device has to go.
        """
        while self._steps:
            step, is_frame = self._steps[0]
            if isinstance(step, HangUp):
                self.clear()
                return step
            if isinstance(step, Mute):
                self._muted, self._muted_for_ever = True, self._muted_for_ever or step.ever
            elif isinstance(step, Pause | Rubbish):
                if now_s < self._begin(step.seconds, now_s):
                    if isinstance(step, Rubbish):
                        self._write(write, step.block)
                    return None
                self._until_s = None
            elif not self._muted:
                sent = self._write(write, step[:WRITE_BYTES])
                if sent < len(step):
                    self._steps[0] = step[sent:], is_frame
                    if sent == 0:
                        return None
                    continue
            self._steps.popleft()
        return None

    def _begin(self, seconds: float, now_s: float) -> float:
        if self._until_s is None:
            self._until_s = now_s + seconds
        return self._until_s

    @staticmethod
    def _write(write: Write, data: bytes | memoryview) -> int:
        try:
            return write(data)
        except BlockingIOError:
            return 0


def writer(fd: int) -> Write:
    """``os.write`` to a file descriptor."""
    return lambda data: os.write(fd, data)
