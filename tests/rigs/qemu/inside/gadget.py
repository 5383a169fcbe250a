"""A USB device made of software: the kernel's gadget framework, set up through configfs."""

from __future__ import annotations

import contextlib
import subprocess
from pathlib import Path

CONFIGFS = Path("/sys/kernel/config/usb_gadget")
VENDOR_ID, PRODUCT_ID = 0x0483, 0x5740  # ST's generic serial port, as an eRTIS has


class Gadget:
    """One device on one socket, unplugged at first.

    Parameters
    ----------
    function
        ``acm``, a serial port; or ``ffs``, endpoints that a program serves under ``ffs_folder``.
    serial_number, product
        Strings that the host reads.
    socket
        0 or 1, that it is plugged into.
    """

    def __init__(
        self, function: str, *, serial_number: str, product: str = "eRTIS", socket: int = 0
    ) -> None:
        self.function = function
        self.serial_number = serial_number
        self.product = product
        self._udc = f"dummy_udc.{socket}"
        self._name = f"socket{socket}"
        self._folder = CONFIGFS / self._name
        self.ffs_folder = Path("/dev/shm") / f"ffs-{self._name}"

    def make(self) -> None:
        """Describe the device to the kernel."""
        strings = self._folder / "strings" / "0x409"
        function = self._folder / "functions" / f"{self.function}.{self._name}"
        for folder in (strings, self._folder / "configs" / "c.1", function):
            folder.mkdir(parents=True)
        for name, value in {
            "idVendor": f"0x{VENDOR_ID:04x}",
            "idProduct": f"0x{PRODUCT_ID:04x}",
            "bcdUSB": "0x0200",
            "bDeviceClass": "2" if self.function == "acm" else "0",
        }.items():
            (self._folder / name).write_text(value)
        (strings / "serialnumber").write_text(self.serial_number)
        (strings / "product").write_text(self.product)
        (strings / "manufacturer").write_text("CoSys-Lab")
        (self._folder / "configs" / "c.1" / "function").symlink_to(function)
        if self.function == "ffs":
            self.ffs_folder.mkdir()
            command = ["mount", "-t", "functionfs", self._name, str(self.ffs_folder)]
            subprocess.run(command, check=True)

    def plug(self) -> None:
        """Into the socket."""
        (self._folder / "UDC").write_text(self._udc)

    def unplug(self) -> None:
        """Out of the socket, at once."""
        (self._folder / "UDC").write_text("\n")

    def remove(self) -> None:
        """Forget it; who serves it must have ended."""
        with contextlib.suppress(OSError):
            self.unplug()
        if self.function == "ffs":
            subprocess.run(["umount", str(self.ffs_folder)], check=True)
            self.ffs_folder.rmdir()
        (self._folder / "configs" / "c.1" / "function").unlink()
        for folder in ("configs/c.1", f"functions/{self.function}.{self._name}", "strings/0x409"):
            (self._folder / folder).rmdir()
        self._folder.rmdir()

    @property
    def acm_port(self) -> str:
        """The device's own end of the serial port."""
        number = (self._folder / "functions" / f"acm.{self._name}" / "port_num").read_text()
        return f"/dev/ttyGS{number.strip()}"
