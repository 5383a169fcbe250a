"""The board's process: our firmware behind a port, misbehaving when told to."""

from __future__ import annotations

import os
import threading
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np

from ertis_driver.firmware import FirmwareState
from qemu.inside.gadget import Gadget
from qemu.inside.ports import AcmPort, FfsPort, Port, Unplugged

MAX_WORDS = 163_840
NOISE = np.random.default_rng(7).integers(0, 2**32, MAX_WORDS, dtype=np.uint32)


def sound(index: int, num_words: int, *, active: bool) -> np.ndarray:
    """What a board hears at its ping ``index``: each ping is another one."""
    return NOISE[:num_words] + np.uint32((2 * index + active) * 2_654_435_761 % 2**32)


class Sounds:
    """Implements ``FrameSource``."""

    def next_frame(self, request):
        """As ``sound`` says."""
        return sound(request.index, request.num_words, active=request.active)


@dataclass(frozen=True)
class Vanish:
    """Unplug itself after ``at`` bytes of the frame, come back after ``away_s``."""

    at: int
    away_s: float


@dataclass(frozen=True)
class Stall:
    """Halt the endpoint after ``at`` bytes, send the rest once the host has cleared that."""

    at: int


@dataclass(frozen=True)
class Deaf:
    """After the frame, halt the endpoint that takes commands, until the host clears that."""


@dataclass(frozen=True)
class Pieces:
    """Send the frame as transfers of these sizes, over and over; 0 is an empty packet."""

    sizes: Sequence[int]


@dataclass(frozen=True)
class Surplus:
    """Send rubbish before and behind the frame, in the same transfer as its ends."""

    before: int
    behind: int


Fault = Vanish | Stall | Deaf | Pieces | Surplus


class Firmware:
    """In the board's process."""

    def __init__(self, gadget: Gadget, port: Port) -> None:
        self._gadget = gadget
        self._port = port
        self._state = FirmwareState(Sounds())
        self._fault: Fault | None = None
        self._plugged_at_s = 0.0
        self._plugged = threading.Event()

    def run(self) -> None:
        """Answer for ever."""
        while True:
            try:
                for reply in self._state.feed(self._port.read()):
                    self._send(reply)
            except Unplugged:
                self._port.open()

    def _send(self, reply: bytes) -> None:
        fault = self._fault if len(reply) > 4 else None
        if fault is None:
            self._port.write(reply)
            return
        self._fault = None
        if isinstance(fault, Vanish):
            self._port.write(reply[: fault.at])
            self.unplug()
            self._port.open()
            time.sleep(fault.away_s)
            self.plug()
        elif isinstance(fault, Stall):
            self._port.write(reply[: fault.at])
            self._port.stall()
            self._port.write(reply[fault.at :])
        elif isinstance(fault, Deaf):
            self._port.write(reply)
            self._port.stall_commands()
        elif isinstance(fault, Pieces):
            position = 0
            while position < len(reply):
                for size in fault.sizes:
                    self._port.write(reply[position : position + size])
                    position += size
        else:
            rubbish = bytes(range(1, 200)) * (1 + max(fault.before, fault.behind) // 199)
            self._port.write(rubbish[: fault.before] + reply + rubbish[: fault.behind])

    def fault(self, fault: Fault) -> None:
        self._fault = fault

    def unplug(self) -> None:
        self._plugged.clear()
        self._gadget.unplug()

    def plug(self) -> None:
        self._plugged_at_s = time.monotonic()
        self._gadget.plug()
        self._plugged.set()

    def wait_until_plugged(self) -> None:
        self._plugged.wait()

    def plugged_at(self) -> float:
        return self._plugged_at_s


def serve(gadget: Gadget, conn: Connection) -> None:
    if gadget.function == "acm":
        port = AcmPort(gadget.acm_port)
    else:
        port = FfsPort(gadget.ffs_folder)
        port.describe()
    firmware = Firmware(gadget, port)
    port.open()
    firmware.plug()
    threading.Thread(target=_run, args=(firmware,), daemon=True).start()
    conn.send(None)
    while True:
        what, *args = conn.recv()
        conn.send(getattr(firmware, what)(*args))


def _run(firmware: Firmware) -> None:
    try:
        firmware.run()
    finally:  # a board whose firmware died must not look alive
        traceback.print_exc()
        os._exit(3)
