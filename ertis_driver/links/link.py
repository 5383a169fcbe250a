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

    def fill(self, buffer: memoryview, deadline: float, gap_s: float, end: float) -> int:
        """Read on until ``buffer`` is full.

        Parameters
        ----------
        deadline
            By when the first byte must come.
        gap_s
            How long it may be silent after that, s; a tenth of a second more is no defect.
        end
            By when all must be over.

        Returns
        -------
        int
            How many bytes came.

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


def fill_by_pieces(
    link: Link, buffer: memoryview, deadline: float, gap_s: float, end: float
) -> int:
    """``Link.fill`` by its ``read_into``."""
    count = 0
    while got := link.read_into(buffer[count:], deadline):
        count += got
        now = time.monotonic()
        if count == len(buffer) or now >= end:
            break
        deadline = min(end, now + gap_s)
    return count
