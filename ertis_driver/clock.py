"""Host time of pings, and whether somebody set the clock between two of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

STEP_NS = 1_000_000  # smaller is noise of the reading; a clock that is slewed never steps
_READINGS = 10
_PROMPT_NS = 100_000  # between two readings: nobody was scheduled away


def read_clocks() -> tuple[int, int]:
    """UNIX time and time since boot at one instant, ns.

    CLOCK_BOOTTIME runs on while the machine sleeps (CLOCK_MONOTONIC does not: each suspend would
    look like a step), and is slewed together with UNIX time: their difference changes only when
    the clock is set.
    """
    for _ in range(_READINGS):
        before = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        unix_ns = time.time_ns()
        after = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        if after - before < _PROMPT_NS:
            break
    return unix_ns, (before + after) // 2


class HostClock:
    """The host's UNIX time, with its steps noticed.

    Parameters
    ----------
    read
        Gives UNIX time and time since boot, ns.
    """

    def __init__(self, read: Callable[[], tuple[int, int]] = read_clocks) -> None:
        self._read = read
        self._offset_ns: int | None = None
        self._step_ns = 0

    def unix_ns(self, monotonic_s: float) -> tuple[int, int]:
        """UNIX time of an instant of ``time.monotonic()`` (s), on the clock as it is set now.

        Returns
        -------
        tuple of int
            The time, and how far it may be off as the two clocks are not read at one instant, ns.
        """
        now_s, half_s, (unix_ns, boot_ns) = self._read_beside()
        self._notice_step(unix_ns - boot_ns)
        return unix_ns - round((now_s - monotonic_s) * 1e9), math.ceil(half_s * 1e9)

    def _read_beside(self) -> tuple[float, float, tuple[int, int]]:
        """Monotonic time, how far from there the clocks were read at most (s), and what they told.

        A thread may be scheduled away in between, for as long as it takes others to hear a ping:
        the promptest of some readings is taken.
        """
        readings = []
        for _ in range(_READINGS):
            before_s = time.monotonic()
            told = self._read()
            after_s = time.monotonic()
            readings.append(((before_s + after_s) / 2, (after_s - before_s) / 2, told))
            if after_s - before_s < 1e-9 * _PROMPT_NS:
                break
        return min(readings, key=lambda reading: reading[1])

    def _notice_step(self, offset_ns: int) -> None:
        if self._offset_ns is not None:
            step_ns = offset_ns - self._offset_ns
            if abs(step_ns) < STEP_NS:
                return  # the old offset stays: small ones must add up
            self._step_ns += step_ns
        self._offset_ns = offset_ns

    def take_step_ns(self) -> int:
        """How far the clock was set since this was last asked, ns; forward is positive."""
        step_ns, self._step_ns = self._step_ns, 0
        return step_ns
