"""The device's ping counter: the only thing on the wire that tells a lost ping."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Literal

from ertis_driver.protocol import INDEX_MODULUS

# Pings that may be missing at once whatever the clock says; above it, only what there was time for.
GAP_ALLOWANCE = 1_000

Step = Literal["next", "again", "restart"]


def missing_between(last: int, index: int) -> int:
    """Pings missing between two that were heard one after the other; 0 if the counter fell back.

    For whoever does not know how fast pings can come: a ``PingCounter`` judges by time as well.
    """
    step = (index - last) % INDEX_MODULUS
    return step - 1 if 0 < step < INDEX_MODULUS // 2 else 0


class PingCounter:
    """Counts lost pings by the gaps in the index, modulo 2**32.

    An index that falls, or rises by more pings than there was time for, is no loss of billions: the
    device counts anew, or the index is damaged.

    Parameters
    ----------
    listening_s
        What one ping takes at least, s.
    now_s
        A monotonic clock, s.

    Attributes
    ----------
    pings_lost : int
        All gaps together.
    restarts : int
        How often the counter began anew.
    """

    def __init__(self, listening_s: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self.listening_s = listening_s
        self.pings_lost = 0
        self.restarts = 0
        self._now_s = now_s
        self._last_index: int | None = None
        self._last_s = 0.0

    @property
    def last_index(self) -> int | None:
        """Index of the last ping taken; None if the next one may have any."""
        return self._last_index

    def forget(self) -> None:
        """Expect any index next."""
        self._last_index = None

    def plausible(self, index: int) -> bool:
        """Whether a ping of this index may come next."""
        if self._last_index is None:
            return True
        return 0 < (index - self._last_index) % INDEX_MODULUS <= 1 + self._max_gap()

    def take(self, index: int) -> Step:
        """Count what is missing before this ping.

        Returns
        -------
        str
            ``next``: a later ping. ``again``: the last ping once more. ``restart``: neither; the
            counter now stands at this index.
        """
        if index == self._last_index:
            return "again"
        step: Step = "next"
        if not self.plausible(index):
            self.restarts += 1
            step = "restart"
        elif self._last_index is not None:
            self.pings_lost += (index - self._last_index) % INDEX_MODULUS - 1
        self._last_index = index
        self._last_s = self._now_s()
        return step

    def drop(self) -> None:
        """Count the ping just taken as lost."""
        self.pings_lost += 1

    def _max_gap(self) -> int:
        return GAP_ALLOWANCE + int((self._now_s() - self._last_s) / self.listening_s)
