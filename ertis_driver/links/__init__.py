"""Byte pipes to the device: open, read, write, close, and what went wrong. Nothing else.

``UsbLink`` is in ``ertis_driver.links.usb``: who has a serial port needs no pyusb.
"""

from ertis_driver.links.link import Link
from ertis_driver.links.serial import SerialLink

__all__ = ["Link", "SerialLink"]
