"""The firmware behind a pty: what a client sees on ``/dev/ttyACM0``, without the hardware."""

from __future__ import annotations

import logging
import os
import select
import threading
import tty
from collections import deque

from typing_extensions import Self

from ertis_driver.closing import Closing
from ertis_driver.firmware import FirmwareState, FrameSource, PingRequest
from ertis_driver.frame import Source

__all__ = ["Emulator", "FrameSource", "PingRequest"]

log = logging.getLogger(__name__)

POLL_S = 0.05  # how late a stop may be noticed
WRITE_BYTES = 65_536


class Emulator(Closing):
    """Answers on a pty as the firmware does. Also a context manager that serves in a thread.

    Clients may come and go. A frame that nobody reads waits, and is dropped when the next command
    arrives: whoever sent that has given it up.

    Parameters
    ----------
    source
        Makes the frames.
    mark
        What the device says it is: ``sim`` or ``replay``. ``live`` would be a lie to any event
        made from it, and is for tests of the driver alone.
    firmware
        Version to answer with, ``major.minor.bugfix``.
    """

    def __init__(
        self, source: FrameSource, *, mark: Source = "sim", firmware: str = "2.3.4"
    ) -> None:
        self.state = FirmwareState(source, mark=mark, firmware=firmware)
        self._master, self._slave = os.openpty()
        # Before anyone opens it: a cooked tty echoes. The slave stays open here so that it stays
        # raw, and so that a client that closes does not hang up the master.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path = os.ttyname(self._slave)
        self._pending: deque[memoryview] = deque()
        self._frame_pending = False
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False

    @property
    def path(self) -> str:
        """The port for clients to open."""
        return self._path

    def serve(self, stop: threading.Event) -> None:
        """Answer until ``stop`` is set; late by 50 ms, or by the frame in the making, at most."""
        while not stop.is_set():
            writers = [self._master] if self._pending else []
            readable, writable, _ = select.select([self._master], writers, [], POLL_S)
            if readable:
                self._receive()
            if writable:
                self._send()

    def start(self) -> None:
        """Serve in a thread, until ``close``."""
        self._thread = threading.Thread(
            target=self.serve, args=(self._stop,), name=f"emulator {self._path}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop the thread, if there is one, and hang up. May be called twice."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if not self._closed:
            self._closed = True
            os.close(self._master)
            os.close(self._slave)

    def __enter__(self) -> Self:
        """Serve in a thread."""
        self.start()
        return self

    def _receive(self) -> None:
        try:
            data = os.read(self._master, WRITE_BYTES)
        except BlockingIOError:
            return
        for reply in self.state.feed(data):
            if self._frame_pending and self._pending:
                log.warning("a command arrived before the frame was read: its rest is dropped")
                self._pending.clear()
            self._frame_pending = len(reply) > 4
            self._pending.append(memoryview(reply))

    def _send(self) -> None:
        while self._pending:
            part = self._pending[0]
            try:
                sent = os.write(self._master, part[:WRITE_BYTES])
            except BlockingIOError:
                return
            if sent < len(part):
                self._pending[0] = part[sent:]
            else:
                self._pending.popleft()
