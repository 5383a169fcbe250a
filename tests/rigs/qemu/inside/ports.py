"""The device's own end of its USB endpoints: read commands, write replies, misbehave."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

WRITE_BYTES = 65_536
HALT_TRIES = 500
CDC_CONTROL, CDC_DATA = 0x02, 0x0A  # interface classes


class Unplugged(Exception):
    """The host is gone."""


class Port(Protocol):
    """Blocking, and for one thread."""

    def open(self) -> None:
        """Be ready for a host to come, or to come back."""

    def read(self) -> bytes:
        """Wait for what the host sends; raise ``Unplugged``."""

    def write(self, data: bytes) -> None:
        """Send all; raise ``Unplugged``."""

    def stall(self) -> None:
        """Halt the endpoint to the host, until the host clears that."""

    def stall_commands(self) -> None:
        """Halt the endpoint from the host, until the host clears that."""


class AcmPort:
    """The gadget side of a CDC-ACM serial port."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._fd = -1

    def open(self) -> None:
        """Open and make raw, before a host comes: a cooked port would echo."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self._fd)

    def read(self) -> bytes:
        """Wait for a command."""
        with _unplugged_if(errno.EIO):
            data = os.read(self._fd, WRITE_BYTES)
        if not data:
            raise Unplugged
        return data

    def write(self, data: bytes) -> None:
        """Hand all to the kernel, which holds up to 8 kB of it."""
        rest = memoryview(data)
        with _unplugged_if(errno.EIO):
            while rest:
                rest = rest[os.write(self._fd, rest[:WRITE_BYTES]) :]

    def stall(self) -> None:
        """Not for a serial port."""
        raise NotImplementedError("a serial function cannot stall: use FunctionFS")

    stall_commands = stall


def _interface(number: int, num_endpoints: int, interface_class: int) -> bytes:
    return struct.pack("<BBBBBBBBB", 9, 4, number, 0, num_endpoints, interface_class, 0, 0, 1)


def _endpoint(address: int, attributes: int, max_packet: int, interval: int) -> bytes:
    return struct.pack("<BBBBHB", 7, 5, address, attributes, max_packet, interval)


def _descriptors(max_packet: int, interval: int) -> bytes:
    """As CDC has them, without its functional descriptors, which FunctionFS refuses.

    So the host's cdc-acm lets it be, and only libusb can talk to it.
    """
    return (
        _interface(0, 1, CDC_CONTROL)
        + _endpoint(0x81, 3, 8, interval)
        + _interface(1, 2, CDC_DATA)
        + _endpoint(0x02, 2, max_packet, 0)
        + _endpoint(0x83, 2, max_packet, 0)
    )


class FfsPort:
    """Bulk endpoints served through FunctionFS: these can do all that USB can."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._out = self._in = -1

    def describe(self) -> None:
        """Tell the kernel which endpoints there are; needed before it can be plugged in."""
        control = os.open(self._folder / "ep0", os.O_RDWR)
        both = struct.pack("<II", 5, 5) + _descriptors(64, 10) + _descriptors(512, 8)
        os.write(control, struct.pack("<III", 3, 12 + len(both), 3) + both)
        text = b"\x09\x04eRTIS\0"
        os.write(control, struct.pack("<IIII", 2, 16 + len(text), 1, 1) + text)
        threading.Thread(target=self._answer_control, args=(control,), daemon=True).start()

    def open(self) -> None:
        """Open the bulk endpoints."""
        for fd in (self._out, self._in):
            if fd >= 0:
                os.close(fd)
        self._out = os.open(self._folder / "ep2", os.O_RDWR)
        self._in = os.open(self._folder / "ep3", os.O_RDWR)

    def read(self) -> bytes:
        """Wait for one transfer."""
        with _unplugged_if(errno.ESHUTDOWN, errno.ENODEV):
            return os.read(self._out, 16_384)

    def write(self, data: bytes) -> None:
        """Send as transfers of 64 KiB; each ends in a short packet if it is no multiple of 512."""
        view = memoryview(data)
        with _unplugged_if(errno.ESHUTDOWN, errno.ENODEV):
            os.write(self._in, view[:WRITE_BYTES])  # once also when there is nothing to send
            for start in range(WRITE_BYTES, len(view), WRITE_BYTES):
                os.write(self._in, view[start : start + WRITE_BYTES])

    def stall(self) -> None:
        """FunctionFS halts an endpoint that is used the wrong way round."""
        _halt(lambda: os.read(self._in, 1))

    def stall_commands(self) -> None:
        """As ``stall``, the other way round."""
        _halt(lambda: os.write(self._out, b"?"))

    @staticmethod
    def _answer_control(control: int) -> None:
        """Accept every class request: line coding and control lines mean nothing here."""
        while True:
            event = os.read(control, 12)
            if len(event) == 12 and event[8] == 4:  # SETUP
                request_type, _, _, _, length = struct.unpack("<BBHHH", event[:8])
                with contextlib.suppress(OSError):  # the host may have given up
                    if request_type & 0x80:
                        os.write(control, bytes(length))
                    else:
                        os.read(control, length)


def _halt(misuse: Callable[[], object]) -> None:
    for _ in range(HALT_TRIES):
        try:
            misuse()
        except BlockingIOError:  # the host has not taken all of the last transfer
            time.sleep(0.01)
        except OSError as error:
            if error.errno != errno.EBADMSG:
                raise
            return
    raise RuntimeError("the endpoint did not halt")


@contextlib.contextmanager
def _unplugged_if(*numbers: int):
    try:
        yield
    except OSError as error:
        if error.errno not in numbers:
            raise
        raise Unplugged from error
