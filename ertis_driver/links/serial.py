"""The sonar as a tty, through the kernel's cdc-acm driver."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
import threading
import time
import tty

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
from ertis_driver.links.link import left_s

NOMINAL_BAUD = 115_200  # USB CDC-ACM ignores it
MAX_POLL_MS = 2**31 - 1  # what poll takes: 24 days


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
            _let_reads_end(self._fd)
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
            termios.tcflush(self._fd, termios.TCIOFLUSH)
        except (OSError, termios.error) as error:
            self._serial.close()
            raise _open_error(port, error) from error
        # Held while the descriptor is in use: closed under a select, its number may be another
        # file's by the time that returns.
        self._in_use = threading.RLock()
        self._closing_once = threading.Lock()
        self._closing = False
        self._wake_read, self._wake_write = os.pipe()
        self._incoming, self._outgoing = (
            self._poll_for(event) for event in (select.POLLIN, select.POLLOUT)
        )

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
            If the device is gone, or closed in another thread.
        """
        sent = 0
        with self._in_use:
            while sent < len(data):
                self._check_open()
                try:
                    ready = _wait(self._outgoing, deadline)
                    if ready and not self._closing:
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
            If the device is gone, or closed in another thread.
        """
        with self._in_use:
            while True:
                self._check_open()
                try:
                    # pyserial's read would drop what it has when the device goes away.
                    count = os.readv(self._fd, [buffer])
                except BlockingIOError:
                    if _wait(self._incoming, deadline):
                        continue
                    return 0
                except OSError as error:
                    raise self._lost(error) from error
                if count == 0:
                    raise self._lost(None)
                return count

    def fill(self, buffer: memoryview, deadline: float, gap_s: float, end: float) -> int:
        """Read on until ``buffer`` is full, silent for too long, or at the end.

        A tty hands out 4 KB at a time: a frame is 160 reads, which are not waited for one by one.

        Raises
        ------
        DeviceLost
            If the device is gone, or closed in another thread.
        """
        count = 0
        while time.monotonic() < end:
            count += self._read_flow(buffer[count:], end)
            if count == len(buffer):
                break
            got = self.read_into(buffer[count:], min(deadline, end))
            if got == 0:
                break
            count += got
            deadline = time.monotonic() + gap_s
        return count

    def close(self) -> None:
        """Give the port back. May be called twice, and from any thread."""
        with self._closing_once:
            if not self._closing:
                self._closing = True
                os.write(self._wake_write, b"x")
        with self._in_use:
            if self._fd < 0:
                return
            # The kernel keeps the mark for as long as anyone holds the tty open; a device that is
            # gone has taken it along.
            with contextlib.suppress(OSError):
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
            self._serial.close()
            os.close(self._wake_read)
            os.close(self._wake_write)
            self._fd = self._wake_read = self._wake_write = -1

    def _poll_for(self, event: int) -> select.poll:
        # Not select.select: it knows no descriptor beyond 1023.
        poll = select.poll()
        poll.register(self._fd, event)
        poll.register(self._wake_read, select.POLLIN)
        return poll

    def _read_flow(self, buffer: memoryview, end: float) -> int:
        """Read as long as bytes come without a gap, the kernel doing the waiting."""
        count = 0
        with self._in_use:
            self._check_open()
            flags = fcntl.fcntl(self._fd, fcntl.F_GETFL)
            fcntl.fcntl(self._fd, fcntl.F_SETFL, flags & ~os.O_NONBLOCK)
            try:
                while count < len(buffer) and not self._closing and time.monotonic() < end:
                    got = os.readv(self._fd, [buffer[count:]])
                    if got == 0:  # a gap, or the end: read_into tells
                        break
                    count += got
            except OSError as error:
                raise self._lost(error) from error
            finally:
                if self._fd >= 0:
                    fcntl.fcntl(self._fd, fcntl.F_SETFL, flags)
        return count

    def _check_open(self) -> None:
        if self._closing:
            raise DeviceLost(f"{self._name} is closed: reopen it")

    def _lost(self, error: Exception | None) -> DeviceLost:
        # First: a dead descriptor that stays open makes the device come back under another name.
        self.close()
        reason = error or "it hung up"
        return DeviceLost(f"{self._name} went away ({reason}): check the cable and reopen it")


def _let_reads_end(fd: int) -> None:
    """A read that waits ends after a tenth of a second without a byte (VTIME, termios(3))."""
    attributes = termios.tcgetattr(fd)
    attributes[6][termios.VMIN], attributes[6][termios.VTIME] = 0, 1
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _wait(poll: select.poll, deadline: float) -> bool:
    """Whether the port is ready, has gone away, or is being closed, by the deadline."""
    return bool(poll.poll(min(1000.0 * left_s(deadline), MAX_POLL_MS)))


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
            f"no device at {port} ({os.strerror(number)}): check cable, power and port name; "
            "`ertis devices` lists what is plugged in"
        )
    if number in (errno.EACCES, errno.EPERM):
        return DevicePermission(
            f"may not open {port} ({os.strerror(number)}): install the udev rule "
            "(`sudo make udev`) and replug it, or join the group dialout"
        )
    if number in (errno.EBUSY, errno.EAGAIN):
        return DeviceBusy(
            f"{port} is in use by another process: end that one first; `ertis devices` names it"
        )
    if number in (errno.ENOTTY, errno.EISDIR, errno.EINVAL):
        return WrongDevice(f"{port} is not a serial port: name the sonar's, such as /dev/ttyACM0")
    return DeviceNotFound(f"cannot open {port} ({error}): check cable and port name")
