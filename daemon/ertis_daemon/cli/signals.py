"""Ctrl-C and SIGTERM as an event that loops look at."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class StopFlag:
    """Set by the first signal.

    event : threading.Event
        Set once there was one.
    interrupted : bool
        It was Ctrl-C.
    """

    def __init__(self) -> None:
        self.event = threading.Event()
        self.interrupted = False


@contextmanager
def stop_on_signals() -> Iterator[StopFlag]:
    """Turn SIGINT and SIGTERM into a flag; a second Ctrl-C raises KeyboardInterrupt as usual.

    Only for the main thread. Python runs the handler between two bytecodes of that thread, so
    what it does meanwhile must not block for long.
    """
    flag = StopFlag()

    def handle(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGINT:
            flag.interrupted = True
            signal.signal(signal.SIGINT, signal.default_int_handler)
        flag.event.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield flag
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
