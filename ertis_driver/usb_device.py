"""The hardware over libusb: ``usb:`` addresses."""

from __future__ import annotations

from typing import Any

from ertis_driver.ertis_device import ErtisDevice
from ertis_driver.links.usb import UsbLink


def open_usb(where: str, **options: Any) -> ErtisDevice:
    """Open the eRTIS at ``VID:PID``, ``VID:PID:SERIAL`` or ``sn=SERIAL``.

    Parameters
    ----------
    options
        Passed on to ``ErtisDevice``.

    Raises
    ------
    AddressError, DeviceNotFound, DevicePermission, DeviceBusy, WrongDevice, DeviceTimeout
    """
    return ErtisDevice(UsbLink(where), f"usb:{where}", **options)
