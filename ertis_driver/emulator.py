"""The firmware behind a pty: what a client sees on ``/dev/ttyACM0``, without the hardware."""

from __future__ import annotations

import logging
import os
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Collection
from contextlib import suppress
from pathlib import Path

from typing_extensions import Self

from ertis_driver.closing import Closing
from ertis_driver.errors import SettingsError
from ertis_driver.fault_plan import FaultInjector, FaultPlan
from ertis_driver.firmware import FirmwareState, FrameSource, PingRequest
from ertis_driver.frame import Source
from ertis_driver.outbox import Outbox, writer
from ertis_driver.protocol import TriggerForm

__all__ = ["Emulator", "FrameSource", "PingRequest"]

log = logging.getLogger(__name__)

POLL_S = 0.05  # how late a stop may be noticed
READ_BYTES = 65_536
MAX_EDGES = 64  # waiting for a frame each


class _Pty:
    """A raw pty."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        # Before anyone opens it: a cooked tty echoes. The slave stays open here so that it stays
        # raw, and so that a client that closes does not hang up the master.
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.path = os.ttyname(self._slave)

    def close(self) -> None:
        os.close(self.master)
        os.close(self._slave)


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
    trigger_form, unsupported
        As ``FirmwareState`` has them.
    faults
        What shall go wrong on the wire.
    link
        A symbolic link to keep pointed at the port, which has another path after a replug.
    on_plug
        Called with the port's path each time that it is back after an unplug.

    Raises
    ------
    SettingsError
        If anything but a link is in the link's place, or it cannot be made.
    """

    def __init__(
        self,
        source: FrameSource,
        *,
        mark: Source = "sim",
        firmware: str = "2.3.4",
        trigger_form: TriggerForm = "linux",
        unsupported: Collection[str] = (),
        faults: FaultPlan | None = None,
        link: Path | None = None,
        on_plug: Callable[[str], None] | None = None,
    ) -> None:
        self.state = FirmwareState(
            source, mark=mark, firmware=firmware, trigger_form=trigger_form, unsupported=unsupported
        )
        self.injector = FaultInjector(faults, self.state)
        self._outbox = Outbox()
        self._edges: deque[int] = deque()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._closed = False
        self._link = link
        self._on_plug = on_plug
        self._pty: _Pty | None = None
        self._path = self._plug_in()
        self._wake_out, self._wake_in = os.pipe()
        os.set_blocking(self._wake_in, False)
        os.set_blocking(self._wake_out, False)

    @property
    def path(self) -> str:
        """The port for clients to open; the last one, while it is unplugged."""
        return self._path

    def serve(self, stop: threading.Event) -> None:
        """Answer until ``stop`` is set, or until it is unplugged for ever.

        Late by 50 ms, or by the frame in the making, at most.
        """
        while not stop.is_set() and self._pty is not None:
            self._step(self._pty, stop)

    def trigger(self, pin: int) -> None:
        """Put an edge on an external trigger pin, 1 or 2; from any thread or signal handler."""
        if len(self._edges) >= MAX_EDGES:
            log.warning("%d edges wait: one more on pin %d is dropped", len(self._edges), pin)
            return
        self._edges.append(pin)
        self._wake()

    def start(self) -> None:
        """Serve in a thread, until ``close``."""
        self._thread = threading.Thread(
            target=self.serve, args=(self._stop,), name=f"emulator {self._path}", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop the thread, if there is one, and hang up. May be called twice."""
        self._stop.set()
        if not self._closed:
            self._wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if not self._closed:
            self._closed = True
            self._unplug()
            os.close(self._wake_in)
            os.close(self._wake_out)

    def __enter__(self) -> Self:
        """Serve in a thread."""
        self.start()
        return self

    def _wake(self) -> None:
        with suppress(BlockingIOError):  # it is full of reasons to wake up
            os.write(self._wake_in, b"\0")

    def _step(self, pty: _Pty, stop: threading.Event) -> None:
        patience_s = min(POLL_S, self._outbox.due_in_s(time.monotonic()))
        # Not select.select: it knows no descriptor beyond 1023.
        poll = select.poll()
        poll.register(self._wake_out, select.POLLIN)
        writes = select.POLLOUT if self._outbox.wants_to_write else 0
        poll.register(pty.master, select.POLLIN | writes)
        ready = dict(poll.poll(1000.0 * patience_s))
        if self._wake_out in ready:
            os.read(self._wake_out, READ_BYTES)
        if ready.get(pty.master, 0) & select.POLLIN:
            self._receive(pty)
        self._take_edges()
        gone = self._outbox.advance(writer(pty.master), time.monotonic())
        if gone is None:
            return
        self._unplug()
        log.warning("%s is unplugged for %g s", self._path, gone.away_s)
        if gone.away_s != float("inf") and not stop.wait(gone.away_s):
            self._path = self._plug_in()
            if self._on_plug is not None:
                self._on_plug(self._path)

    def _receive(self, pty: _Pty) -> None:
        try:
            data = os.read(pty.master, READ_BYTES)
        except BlockingIOError:
            return
        replies = self.state.feed(data)
        if replies:
            self._outbox.command_came()
        for reply in replies:
            self._send(reply)

    def _take_edges(self) -> None:
        while self._edges and not self._outbox.is_full:
            frame = self.state.trigger(self._edges.popleft())
            if frame is not None:
                self._send(frame)

    def _send(self, reply: bytes) -> None:
        self._outbox.put(self.injector.inject(reply), is_frame=len(reply) > 4)

    def _plug_in(self) -> str:
        pty = _Pty()
        try:
            if self._link is not None:
                _point(self._link, pty.path)
        except SettingsError:
            pty.close()
            raise
        self._pty = pty
        return pty.path

    def _unplug(self) -> None:
        self._outbox.clear()
        self._edges.clear()
        if self._pty is None:
            return
        # First: once the client has closed its end too, the path may be another device's.
        if self._link is not None and self._link.is_symlink():
            self._link.unlink(missing_ok=True)
        self._pty.close()
        self._pty = None
        # What has no power forgets.
        self.state.reset()


def _point(link: Path, port: str) -> None:
    try:
        if link.is_symlink():
            link.unlink()
        link.symlink_to(port)
    except FileExistsError as error:
        raise SettingsError(f"{link} is no link and is left alone: name another") from error
    except OSError as error:
        raise SettingsError(f"cannot make the link {link}: {error.strerror}") from error
