"""Byte pipes to the device: open, read, write, close, and what went wrong. Nothing else."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import termios
import time
import tty
from typing import Protocol

import serial

from ertis_driver.errors import (
    AddressError,
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DevicePermission,
    DeviceTimeout,
    WrongDevice,
)

NOMINAL_BAUD = 115_200  # USB CDC-ACM ignores it


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
        """Give the port back. May be called twice."""


class SerialLink:
    """A tty, raw and ours alone.

    Parameters
    ----------
    port
        Path, for example ``/dev/ttyACM0``.

    Raises
    ------
    DeviceNotFound, DevicePermission, DeviceBusy, WrongDevice
        If it cannot be opened.
    """

    def __init__(self, port: str) -> None:
        self._name = port
        if not port or "\0" in port:
            raise AddressError(f"serial port {port!r}, expected a path such as /dev/ttyACM0")
        try:
            self._serial = serial.Serial(port, NOMINAL_BAUD, timeout=0, exclusive=True)
        except (OSError, termios.error) as error:  # SerialException is an OSError
            raise _open_error(port, error) from error
        self._fd: int = self._serial.fileno()
        try:
            # A tty left cooked echoes the device's own bytes back to it and adds CRs; pyserial
            # leaves BRKINT as it was, and its exclusive is only an flock that not all heed.
            tty.setraw(self._fd, termios.TCSANOW)
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
            termios.tcflush(self._fd, termios.TCIOFLUSH)
        except (OSError, termios.error) as error:
            self._serial.close()
            raise _open_error(port, error) from error

    @property
    def name(self) -> str:
        """The port's path."""
        return self._name

    def write(self, data: bytes, deadline: float) -> None:
        """Send all of ``data`` by ``deadline`` (``time.monotonic()``, s).

        Raises
        ------
        DeviceTimeout
            If the device does not take it.
        DeviceLost
            If the device is gone.
        """
        sent = 0
        while sent < len(data):
            self._check_open()
            try:
                _, ready, _ = select.select([], [self._fd], [], _left(deadline))
                if ready:
                    sent += os.write(self._fd, data[sent:])
            except BlockingIOError:
                continue
            except (OSError, termios.error) as error:
                raise self._lost(error) from error
            if not ready:
                raise DeviceTimeout(
                    f"{self._name} took {sent} of {len(data)} bytes in time: ping again; "
                    "replug it if that persists"
                )

    def read_into(self, buffer: memoryview, deadline: float) -> int:
        """Wait until ``deadline`` for bytes and put what has come into ``buffer``.

        Returns
        -------
        int
            How many, 0 if none came in time.

        Raises
        ------
        DeviceLost
            If the device is gone.
        """
        while True:
            self._check_open()
            try:
                ready, _, _ = select.select([self._fd], [], [], _left(deadline))
                if not ready:
                    return 0
                # pyserial's read would drop what it has when the device goes away.
                count = os.readv(self._fd, [buffer])
            except BlockingIOError:
                continue
            except (OSError, termios.error) as error:
                raise self._lost(error) from error
            if count == 0:
                raise self._lost(None)
            return count

    def close(self) -> None:
        """Give the port back. May be called twice."""
        if self._serial.is_open:
            try:
                # The kernel keeps the mark for as long as anyone holds the tty open.
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
            except OSError:
                pass  # the device is gone, and its mark with it
            finally:
                self._serial.close()
        self._fd = -1

    def _check_open(self) -> None:
        if self._fd < 0:
            raise DeviceLost(f"{self._name} is closed: reopen it")

    def _lost(self, error: Exception | None) -> DeviceLost:
        # First: a dead descriptor that stays open makes the device come back under another name.
        self.close()
        reason = error or "it hung up"
        return DeviceLost(f"{self._name} went away ({reason}): check the cable and reopen it")


def _left(deadline: float) -> float:
    return max(0.0, deadline - time.monotonic())


def _errno(error: BaseException | None) -> int | None:
    # pyserial wraps termios.error without its number; it is still there as the context.
    while error is not None:
        number = getattr(error, "errno", None)
        if isinstance(error, termios.error) and error.args:
            number = error.args[0]
        if isinstance(number, int):
            return number
        error = error.__context__
    return None


def _open_error(port: str, error: Exception) -> DeviceError:
    number = _errno(error)
    if number in (errno.ENOENT, errno.ENOTDIR, errno.ENXIO, errno.ENODEV, errno.EIO):
        return DeviceNotFound(
            f"no device at {port} ({os.strerror(number)}): check cable, power and port name"
        )
    if number in (errno.EACCES, errno.EPERM):
        return DevicePermission(
            f"may not open {port} ({os.strerror(number)}): install the udev rule or join the "
            "group dialout"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return DeviceBusy(f"{port} is in use by another process: end that one first")
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        return WrongDevice(f"{port} is not a serial port: name the sonar's, such as /dev/ttyACM0")
    return DeviceNotFound(f"cannot open {port} ({error}): check cable and port name")
