"""Ctrl-C, SIGTERM and a closed terminal as an event that loops look at."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class StopFlag:
    """Set by the first signal.

    event : threading.Event
        Set once there was one.
    interrupted : bool
        It was Ctrl-C.
    """

    def __init__(self, event: threading.Event | None = None) -> None:
        self.event = event or threading.Event()
        self.interrupted = False


@contextmanager
def stop_on_signals(
    event: threading.Event | None = None,
    *,
    patient: bool = False,
    hang_up: Callable[[], None] | None = None,
) -> Iterator[StopFlag]:
    """Turn SIGINT, SIGTERM and SIGHUP into a flag; a second Ctrl-C raises KeyboardInterrupt.

    Unless ``patient``: who has processes to end, in bounded time, must not be cut short, and a
    single Ctrl-C may well arrive twice, from the terminal and from make. SIGHUP only calls
    ``hang_up``, if there is one: a daemon has no terminal that could close.

    Only for the main thread. Python runs the handler between two bytecodes of that thread, so
    what it does meanwhile must not block for long.
    """
    flag = StopFlag(event)

    def handle(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP and hang_up is not None:
            hang_up()
            return
        if number == signal.SIGINT:
            flag.interrupted = True
            if not patient:
                signal.signal(signal.SIGINT, signal.default_int_handler)
        flag.event.set()

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield flag
    finally:
        # The second of a pair may come as late as the interpreter's own end.
        ended = patient and flag.event.is_set()
        for number, handler in before.items():
            signal.signal(number, signal.SIG_IGN if ended else handler)
