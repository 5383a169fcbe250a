"""Host time of pings, and whether somebody set the clock between two of them."""

from __future__ import annotations

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

    def unix_ns(self, monotonic_s: float) -> int:
        """UNIX time of an instant of ``time.monotonic()`` (s), on the clock as it is set now."""
        for _ in range(_READINGS):
            now_s = time.monotonic()
            unix_ns, boot_ns = self._read()
            if time.monotonic() - now_s < 2e-9 * _PROMPT_NS:
                break
        age_s = now_s - monotonic_s
        offset_ns = unix_ns - boot_ns
        if self._offset_ns is not None and abs(offset_ns - self._offset_ns) < STEP_NS:
            return unix_ns - round(age_s * 1e9)  # the old offset stays: small ones must add up
        if self._offset_ns is not None:
            self._step_ns += offset_ns - self._offset_ns
        self._offset_ns = offset_ns
        return unix_ns - round(age_s * 1e9)

    def take_step_ns(self) -> int:
        """How far the clock was set since this was last asked, ns; forward is positive."""
        step_ns, self._step_ns = self._step_ns, 0
        return step_ns
