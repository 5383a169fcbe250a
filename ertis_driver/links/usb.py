"""The sonar's CDC data interface through libusb, past the kernel's tty."""

from __future__ import annotations

import array
import contextlib
import errno
import logging
import math
import struct
import threading
from typing import Any

import usb.core
import usb.util

from ertis_driver.errors import DeviceLost, DeviceTimeout, WrongDevice
from ertis_driver.links.link import fill_by_pieces, left_s
from ertis_driver.links.usb_find import find_pyusb, find_usb, open_error, refuse_held

log = logging.getLogger(__name__)

CDC_CONTROL, CDC_DATA = 0x02, 0x0A  # interface classes (USB class definitions for CDC 1.2)
UNION = (0x24, 0x06)  # functional descriptor: which control interface owns which data interface
CLASS_REQUEST = 0x21  # host to device, class, interface
SET_LINE_CODING, SET_CONTROL_LINE_STATE = 0x20, 0x22
LINE_CODING = struct.pack("<IBBB", 115_200, 0, 0, 8)  # nominal; 8N1
DTR_RTS = 3
CONTROL_TIMEOUT_MS = 500
READ_BYTES = 262_144  # a multiple of every packet size; a frame is three transfers
SLICE_S = 0.1  # how late a close in another thread is noticed
MAX_ERRORS = 5  # in a row, without a byte between: clearing the halt does not help


class UsbLink:
    """The bulk pipes of a CDC-ACM device, ours alone.

    The kernel's driver is detached, and given back on close. As on a tty, bytes that a transfer
    error costs are simply missing: the frame parser notices.

    Parameters
    ----------
    where
        ``VID:PID``, ``VID:PID:SERIAL`` or ``sn=SERIAL``; hex digits, and the serial number as the
        device says it.

    Raises
    ------
    AddressError, DeviceNotFound, DevicePermission, DeviceBusy, WrongDevice
        If it cannot be opened.
    """

    def __init__(self, where: str) -> None:
        found = find_usb(where)
        refuse_held(found)
        self._name = f"{found.usb_node} ({found.product or found.usb_id} {found.serial_number})"
        self._device = find_pyusb(found)
        self._detached: list[int] = []
        self._claimed: list[int] = []
        self._in_use = threading.RLock()
        self._closing = False
        self._closed = False
        self._large = array.array("B", bytes(READ_BYTES))
        self._filled = self._large
        self._start = self._end = 0  # what was read and not asked for yet
        self._errors = 0
        try:
            self._open()
        except (usb.core.USBError, NotImplementedError) as error:
            self.close()
            raise open_error(self._name, error) from error
        except BaseException:
            self.close()
            raise

    @property
    def name(self) -> str:
        """Node, product and serial number."""
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
                timeout_ms = _slice_ms(deadline)
                try:
                    sent += self._device.write(self._out, data[sent:], timeout_ms)
                    self._errors = 0
                except usb.core.USBTimeoutError as error:
                    if left_s(deadline) == 0.0:
                        raise DeviceTimeout(
                            f"{self._name} took {sent} of {len(data)} bytes in time: ping again; "
                            "replug it if that persists"
                        ) from error
                except usb.core.USBError as error:
                    self._recover(self._out, error)

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
            while self._start == self._end:
                self._check_open()
                last = left_s(deadline) <= SLICE_S
                self._fill(len(buffer), _slice_ms(deadline))
                if last:
                    break
            count = min(len(buffer), self._end - self._start)
            buffer[:count] = memoryview(self._filled)[self._start : self._start + count]
            self._start += count
            return count

    def fill(self, buffer: memoryview, deadline: float, gap_s: float, end: float) -> int:
        """Read on until ``buffer`` is full, silent for too long, or at the end.

        Raises
        ------
        DeviceLost
            If the device is gone, or closed in another thread.
        """
        return fill_by_pieces(self, buffer, deadline, gap_s, end)

    def close(self) -> None:
        """Give the device back to the kernel. May be called twice, and from any thread."""
        self._closing = True
        with self._in_use:
            if self._closed:
                return
            self._closed = True
            if self._claimed:
                with contextlib.suppress(usb.core.USBError):  # it is gone
                    self._set_control_line_state(0)
            for interface in self._claimed:
                with contextlib.suppress(usb.core.USBError):
                    usb.util.release_interface(self._device, interface)
            for interface in self._detached:
                # The driver of the control interface takes the data interface along: the second
                # one may be done already.
                with contextlib.suppress(usb.core.USBError, NotImplementedError):
                    self._device.attach_kernel_driver(interface)
            usb.util.dispose_resources(self._device)

    def _open(self) -> None:
        interfaces = list(self._device.get_active_configuration())
        data = next((its for its in interfaces if its.bInterfaceClass == CDC_DATA), None)
        ends = {usb.util.endpoint_direction(end.bEndpointAddress): end for end in data or ()}
        if data is None or set(ends) != {usb.util.ENDPOINT_IN, usb.util.ENDPOINT_OUT}:
            raise WrongDevice(f"{self._name} has no CDC data interface: name another device")
        self._in = ends[usb.util.ENDPOINT_IN].bEndpointAddress
        self._out = ends[usb.util.ENDPOINT_OUT].bEndpointAddress
        # Ask for whole packets only: the rest of a longer one would be an overrun.
        self._small = array.array("B", bytes(ends[usb.util.ENDPOINT_IN].wMaxPacketSize))
        self._control = _control_interface(interfaces, data.bInterfaceNumber)
        for interface in (self._control, data.bInterfaceNumber):
            if self._device.is_kernel_driver_active(interface):
                self._device.detach_kernel_driver(interface)
                self._detached.append(interface)
        for interface in (self._control, data.bInterfaceNumber):
            usb.util.claim_interface(self._device, interface)
            self._claimed.append(interface)
        self._set_line()

    def _set_line(self) -> None:
        # Some CDC firmware sends nothing before it is told that somebody listens; some declines.
        try:
            self._control_out(SET_LINE_CODING, 0, LINE_CODING)
            self._set_control_line_state(DTR_RTS)
        except usb.core.USBError as error:
            if error.errno not in (errno.EPIPE, errno.ETIMEDOUT):
                raise
            log.info("%s declines line coding or DTR: %s", self._name, error)

    def _set_control_line_state(self, state: int) -> None:
        self._control_out(SET_CONTROL_LINE_STATE, state, None)

    def _control_out(self, request: int, value: int, data: bytes | None) -> None:
        self._device.ctrl_transfer(
            CLASS_REQUEST, request, value, self._control, data, CONTROL_TIMEOUT_MS
        )

    def _fill(self, wanted: int, timeout_ms: int) -> None:
        """One transfer; it ends with a short packet, a full buffer or the time."""
        self._filled = self._small if wanted <= len(self._small) else self._large
        self._start = self._end = 0
        try:
            self._end = self._device.read(self._in, self._filled, timeout_ms)
            self._errors = 0
        except usb.core.USBTimeoutError:
            pass
        except usb.core.USBError as error:
            self._recover(self._in, error)

    def _recover(self, endpoint: int, error: usb.core.USBError) -> None:
        """Clear a halt or an overrun and go on; anything else is the end."""
        if error.errno not in (errno.EPIPE, errno.EOVERFLOW) or self._errors == MAX_ERRORS:
            raise self._lost(error) from error
        self._errors += 1
        log.warning("%s: %s: bytes were lost, going on", self._name, error)
        try:
            self._device.clear_halt(endpoint)
        except usb.core.USBError as worse:
            raise self._lost(worse) from worse

    def _check_open(self) -> None:
        if self._closing:
            raise DeviceLost(f"{self._name} is closed: reopen it")

    def _lost(self, error: Exception) -> DeviceLost:
        self.close()
        return DeviceLost(f"{self._name} went away ({error}): check the cable and reopen it")


def _control_interface(interfaces: list[Any], data_number: int) -> int:
    """Return the number of the control interface that says the data interface is its own."""
    for interface in interfaces:
        extra = bytes(interface.extra_descriptors)
        while len(extra) >= 3 and extra[0] >= 3:
            if tuple(extra[1:3]) == UNION and data_number in extra[4 : extra[0]]:
                return int(extra[3])
            extra = extra[extra[0] :]
    classes = {its.bInterfaceNumber for its in interfaces if its.bInterfaceClass == CDC_CONTROL}
    return min(classes, default=data_number)


def _slice_ms(deadline: float) -> int:
    # libusb takes 0 for "wait for ever".
    return max(1, math.ceil(1000.0 * min(SLICE_S, left_s(deadline))))
