"""The eRTIS of the guest, as a case handles it: plug it in, make it misbehave, pull it out."""

from __future__ import annotations

import multiprocessing

from ertis_driver.closing import Closing
from qemu.inside.firmware import Fault, serve
from qemu.inside.gadget import Gadget

ANSWER_TIMEOUT_S = 15


class Board(Closing):
    """Plugged in when made, with its firmware running; also a context manager.

    Parameters
    ----------
    function, serial_number, product, socket
        As for ``Gadget``.
    """

    def __init__(self, function: str = "acm", serial_number: str = "ERTIS001", **where) -> None:
        self._gadget = Gadget(function, serial_number=serial_number, **where)
        self._gadget.make()
        # Forked, so that its processor time is not counted as the driver's.
        fork = multiprocessing.get_context("fork")
        self._conn, theirs = fork.Pipe()
        self._process = fork.Process(target=serve, args=(self._gadget, theirs), daemon=True)
        self._process.start()
        self._answer()

    def misbehave(self, fault: Fault) -> None:
        """In the next frame."""
        self._ask("fault", fault)

    def unplug(self) -> None:
        """Pull it out."""
        self._ask("unplug")

    def plug(self) -> None:
        """Plug it in again."""
        self._ask("plug")

    def plugged_at(self) -> float:
        """When it was last plugged in, ``time.monotonic()``, s."""
        return self._ask("plugged_at")

    def wait_until_plugged(self) -> None:
        """After it vanished, until it is back."""
        self._ask("wait_until_plugged")

    def close(self) -> None:
        """Unplug it for good."""
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
            self._gadget.remove()

    def _ask(self, what: str, *args):
        self._conn.send((what, *args))
        return self._answer()

    def _answer(self):
        if not self._conn.poll(ANSWER_TIMEOUT_S):
            raise TimeoutError(f"the board did not answer in {ANSWER_TIMEOUT_S} s")
        return self._conn.recv()
