"""From the part of an address behind ``usb:`` to one device of pyusb's."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import usb.backend.libusb1
import usb.core
from libusb_package import find_library

from ertis_driver.discover import SERIAL_MARK, PluggedIn, holders_of, plugged_in, usb_devices
from ertis_driver.errors import (
    AddressError,
    DeviceBusy,
    DeviceError,
    DeviceNotFound,
    DevicePermission,
)

IDENTITY = re.compile(r"([0-9a-fA-F]{1,4}):([0-9a-fA-F]{1,4})(?::(.+))?")
UDEVD = Path("/run/udev/control")
FORMS = "usb:0483:5740, usb:0483:5740:SERIAL or usb:sn=SERIAL"


def find_usb(where: str) -> PluggedIn:
    """Return the one device that ``VID:PID``, ``VID:PID:SERIAL`` or ``sn=SERIAL`` means.

    Raises
    ------
    AddressError
        If it is malformed, or several devices fit: their serial numbers are in the message.
    DeviceNotFound
        If none fits.
    """
    devices = usb_devices()
    if where.startswith(SERIAL_MARK) and len(where) > len(SERIAL_MARK):
        number = where.removeprefix(SERIAL_MARK)
        met = [device for device in devices if device.serial_number == number]
    else:
        found = IDENTITY.fullmatch(where)
        if found is None:
            raise AddressError(f"address usb:{where}, expected {FORMS}")
        usb_id = f"{int(found[1], 16):04x}:{int(found[2], 16):04x}"
        met = [
            device
            for device in devices
            if device.usb_id == usb_id and found[3] in (None, device.serial_number)
        ]
    if not met:
        seen = "; ".join(str(device) for device in devices)
        raise DeviceNotFound(
            f"no device usb:{where} (plugged in: {seen or 'none'}): check cable and power"
        )
    if len(met) > 1:
        raise AddressError(
            f"usb:{where} is {len(met)} devices: {'; '.join(map(str, met))}; name one, as "
            f"usb:{met[0].usb_id}:SERIAL"
        )
    return met[0]


def refuse_held(device: PluggedIn) -> None:
    """Do not pull the tty from under a process that uses it: the kernel would let us.

    Raises
    ------
    DeviceBusy
    """
    ports = [its.port for its in plugged_in() if its.port and its.sysfs == device.sysfs]
    for holder in holders_of(ports):
        raise DeviceBusy(
            f"{ports[0]} is in use by process {holder.pid} ({holder.command}): end that one first"
        )


def find_pyusb(device: PluggedIn) -> Any:
    """Return the ``usb.core.Device`` at that place.

    Raises
    ------
    DeviceNotFound
        If libusb is missing, or does not see it.
    """
    try:
        found = usb.core.find(backend=_backend(), bus=device.bus, address=device.address)
    except (usb.core.USBError, usb.core.NoBackendError, NotImplementedError) as error:
        raise DeviceNotFound(
            f"libusb does not work here ({error}): it needs AF_NETLINK and /dev/bus/usb"
        ) from error
    if found is None:
        raise DeviceNotFound(f"libusb does not see {device}: replug it; it needs /dev/bus/usb")
    return found


def open_error(name: str, error: Exception) -> DeviceError:
    """Say what an error of libusb's means before the device was ours."""
    number = getattr(error, "errno", None)
    if number in (errno.EACCES, errno.EPERM):
        return DevicePermission(
            f"may not open {name} (permission denied): install the udev rule (`sudo make udev`) "
            "and replug it"
        )
    if number == errno.EBUSY:
        return DeviceBusy(
            f"{name} is in use by another process: end that one first; `ertis devices` names it"
        )
    return DeviceNotFound(f"cannot open {name} ({error}): replug it")


def _backend() -> Any:
    # A libusb built with udev, as Debian's is, learns of a replug from udevd alone, and most
    # containers have none; the package's asks the kernel. pyusb keeps the first that it loads.
    finders = [None, find_library] if UDEVD.exists() else [find_library, None]
    loaded = (usb.backend.libusb1.get_backend(finder) for finder in finders)
    backend = next((its for its in loaded if its is not None), None)
    if backend is None:
        raise usb.core.NoBackendError("no libusb: apt install libusb-1.0-0")
    return backend
