"""Frames off a link, each with a deadline and with the instants at which its bytes came."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from ertis_driver.errors import DeviceTimeout, FrameCorrupt
from ertis_driver.exchanges import QUIET_S, READ_BYTES
from ertis_driver.frame_parser import FrameParser
from ertis_driver.links import Link
from ertis_driver.protocol import HEADER_BYTES, RawFrame, frame_bytes

MIN_BYTES_PER_S = 4e6  # far below USB high speed (33e6 at best); for the deadline only
WAKE_S = 2e-3  # from bytes that come to a process that waits for them
READY_FRAMES = 4  # more than that in one read are kept by nobody


@dataclass(frozen=True, slots=True, eq=False)
class Arrival:
    """A frame, and when it came; ``time.monotonic()``, s.

    first_s : tuple of float
        Earliest and latest instant at which its first byte can have come.
    last_s : float
        When its last byte was read.
    """

    raw: RawFrame
    first_s: tuple[float, float]
    last_s: float


class FrameReader:
    """Reads frames of one size.

    Parameters
    ----------
    link
        An open byte pipe.
    num_words
        PDM words of a frame.
    plausible
        Whether a frame of this index may come next.
    listening_s
        How long the device listens for one, s.
    gap_s
        A frame that stops for so long stays unfinished.
    slack_s
        Patience beyond what listening and sending take, s.
    """

    def __init__(
        self,
        link: Link,
        num_words: int,
        plausible: Callable[[int], bool],
        *,
        listening_s: float,
        gap_s: float,
        slack_s: float,
    ) -> None:
        self._link = link
        self._parser = FrameParser(num_words, plausible)
        self._size = frame_bytes(num_words)
        self._whole_s = listening_s + self._size / MIN_BYTES_PER_S + slack_s
        self._gap_s = gap_s
        self._stale_bytes = memoryview(bytearray(READ_BYTES))
        self._ready: deque[Arrival] = deque(maxlen=READY_FRAMES)
        self._empty_s = time.monotonic()  # when the link last held nothing more than was read
        # For each read: how many bytes there were in all, and between when and when they came.
        self._reads: deque[tuple[int, tuple[float, float]]] = deque()
        self._fed = 0
        self._met = 0
        self._stale = 0

    @property
    def bytes_lost(self) -> int:
        """Bytes that belonged to no frame."""
        return self._stale + self._parser.bytes_lost

    @property
    def frames_corrupt(self) -> int:
        """Frames begun that were cut short or damaged."""
        return self._parser.frames_corrupt

    def start_clean(self) -> bool:
        """Forget everything held; return False if more stale bytes wait on the link."""
        self._parser.clear()
        self._stale += self._size * len(self._ready)
        self._ready.clear()
        self._met = 0
        count = self._link.read_into(self._stale_bytes, 0.0)
        self._stale += count
        return count == 0

    def read(self, begin_s: float) -> Arrival:
        """Return the next frame.

        Parameters
        ----------
        begin_s
            When its first byte must have come, ``time.monotonic()``.

        Raises
        ------
        DeviceTimeout
            If nothing came.
        FrameCorrupt
            If what came is no whole frame.
        DeviceLost
        """
        if self._ready:
            return self._ready.popleft()
        corrupt = self.frames_corrupt
        started_s = time.monotonic()
        end_s = max(begin_s, started_s) + self._whole_s  # also for a device that never falls silent
        gap_s = self._gap_s
        deadline = begin_s if not self._met else started_s + gap_s
        while self._receive(deadline, gap_s, end_s):
            if self._ready:
                return self._ready.popleft()
            if time.monotonic() >= end_s:
                break
            # Once it talks, silence is failure; once it failed, even short silence is the end.
            gap_s = QUIET_S if self.frames_corrupt > corrupt else self._gap_s
            deadline = min(end_s, time.monotonic() + gap_s)
        return self._give_up(time.monotonic() - started_s, corrupt)

    def _give_up(self, waited_s: float, corrupt: int) -> Arrival:
        met, self._met = self._met, 0
        damage = "header or footer wrong" if self.frames_corrupt > corrupt else "then silence"
        self._keep(self._parser.flush())
        if self._ready:
            return self._ready.popleft()
        if met == 0:
            raise DeviceTimeout(
                f"no frame from {self._link.name} in {waited_s:.1f} s: ping again, or replug it"
            )
        raise FrameCorrupt(
            f"frame from {self._link.name}: {met} of {self._size} bytes in {waited_s:.1f} s, "
            f"{damage}; ping again"
        )

    def _receive(self, deadline: float, gap_s: float, end_s: float) -> bool:
        """Read on, and take what is whole; return False if it fell silent."""
        room = self._parser.room()
        begun = self._parser.pending_bytes >= len(HEADER_BYTES)
        if begun:
            begun_s = time.monotonic()
            count = self._link.fill(room, deadline, gap_s, end_s)
            came_s = begun_s, time.monotonic()
        else:
            count, came_s = self._read_timed(room, deadline)
        if count:
            self._met += count
            self._fed += count
            self._reads.append((self._fed, came_s))
            frames = self._parser.took(count)
            self._keep(frames)
            if frames:
                self._met = self._parser.pending_bytes  # what is left belongs to the next frame
            self._forget_reads(self._fed - self._parser.pending_bytes)
        return count == len(room) if begun else count > 0

    def _read_timed(self, room: memoryview, deadline: float) -> tuple[int, tuple[float, float]]:
        """What waits already may have waited for long; what has to be waited for is new."""
        asked_s = time.monotonic()
        if count := self._link.read_into(room, 0.0):
            return count, (self._empty_s, time.monotonic())
        self._empty_s = asked_s
        count = self._link.read_into(room, deadline)
        now_s = time.monotonic()
        return count, (max(asked_s, now_s - WAKE_S), now_s)

    def _forget_reads(self, start: int) -> None:
        while len(self._reads) > 1 and self._reads[0][0] <= start:
            self._reads.popleft()

    def _keep(self, frames: list[RawFrame]) -> None:
        now_s = time.monotonic()
        for raw, start in zip(frames, self._parser.starts, strict=True):
            self._forget_reads(start)
            self._ready.append(Arrival(raw, self._reads[0][1], now_s))
