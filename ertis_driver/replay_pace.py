"""The pings of a recording when they are due, once or over and over."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Iterator

from ertis_driver.errors import SettingsError
from ertis_driver.recording import RecordedPing, Recording

MIN_RATE, MAX_RATE = 1e-3, 1e3


class ReplayPace:
    """Plays a recording at its own pace, a multiple of it, or as fast as it is asked.

    Parameters
    ----------
    recording
        What is played.
    rate : float or None
        1 keeps the recorded times between pings, 2 halves them; None waits for nothing.
    loop
        Begin again after the last ping. Times go on: each round is later than the one before by
        the recording's length, and nothing else changes.

    Raises
    ------
    SettingsError
        If the rate is not one from 0.001 to 1000.
    """

    def __init__(
        self, recording: Recording, *, rate: float | None = None, loop: bool = False
    ) -> None:
        if rate is not None and not MIN_RATE <= rate <= MAX_RATE:
            raise SettingsError(f"replay rate {rate:g}, expected {MIN_RATE:g} to {MAX_RATE:g}")
        self._rate = rate
        self._pings = _forever(recording) if loop else iter(recording)
        self._due: RecordedPing | None = None
        self._start: tuple[float, int] | None = None  # monotonic s, recorded ns
        self._steps_ns = 0  # by which the clock was set while it was recorded

    def peek(self) -> RecordedPing | None:
        """The next ping, whether due or not; None after the last.

        Raises
        ------
        RecordingError
            Where the recording is damaged.
        """
        if self._due is None:
            self._due = next(self._pings, None)
            if self._due is not None:
                self._steps_ns += self._due.frame.clock_step_ns
        return self._due

    def left_s(self) -> float:
        """How long until the next ping is due, s; 0 if it is, or if there is none."""
        ping = self.peek()
        if ping is None or self._rate is None:
            return 0.0
        now_s, recorded_ns = time.monotonic(), ping.frame.ping_time_ns - self._steps_ns
        if self._start is None:
            self._start = now_s, recorded_ns
        started_s, first_ns = self._start
        return max(0.0, started_s + (recorded_ns - first_ns) / 1e9 / self._rate - now_s)

    def wait(self, stop: threading.Event) -> RecordedPing | None:
        """Take the next ping once it is due; None after the last, or if stopped before."""
        while (left_s := self.left_s()) > 0:
            if stop.wait(left_s):
                return None
        return self.take()

    def take(self) -> RecordedPing | None:
        """Take the next ping now; None after the last."""
        ping, self._due = self.peek(), None
        return ping


def _forever(recording: Recording) -> Iterator[RecordedPing]:
    shift_ns = 0
    while True:
        first_ns = last_ns = period_ns = None
        for ping in recording:
            time_ns = ping.frame.ping_time_ns
            if first_ns is None:
                first_ns = time_ns
                # Of a single ping, until the next may begin.
                period_ns = round(ping.frame.words.size / ping.frame.pdm_rate_hz * 1e9)
            else:
                period_ns = time_ns - (last_ns or 0) - ping.frame.clock_step_ns
            last_ns = time_ns
            frame = dataclasses.replace(ping.frame, ping_time_ns=time_ns + shift_ns)
            yield dataclasses.replace(ping, frame=frame)
        if first_ns is None or last_ns is None or period_ns is None:
            return
        shift_ns += last_ns - first_ns + max(period_ns, 1)
