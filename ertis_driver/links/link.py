"""What every byte pipe can do, and what they share."""

from __future__ import annotations

import time
from typing import Protocol


class Link(Protocol):
    """A byte pipe. Deadlines are values of ``time.monotonic()``, s."""

    @property
    def name(self) -> str:
        """The port, for messages."""

    def write(self, data: bytes, deadline: float) -> None:
        """Send all of ``data``.

        Raises
        ------
        DeviceTimeout, DeviceLost
        """

    def read_into(self, buffer: memoryview, deadline: float) -> int:
        """Wait for bytes, put what has come into ``buffer``; 0 if the deadline came first.

        Raises
        ------
        DeviceLost
        """

    def close(self) -> None:
        """Give the port back. May be called twice, and from any thread.

        A read or write in progress in another thread ends with ``DeviceLost``.
        """


def left_s(deadline: float) -> float:
    """Time until ``deadline``, s; 0 if it has passed."""
    return max(0.0, deadline - time.monotonic())
