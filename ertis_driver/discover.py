"""What is plugged in, what it says it is, and who holds it."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from serial.tools import list_ports

from ertis_driver.errors import AddressError, DeviceNotFound

SYS_USB = Path("/sys/bus/usb/devices")
LISTING_ATTEMPTS = 5  # pyserial trips over a device that leaves or arrives while it looks
LISTING_PAUSE_S = 0.02
SERIAL_MARK = "sn="  # serial:sn=ABC and usb:sn=ABC: by the device's serial number


@dataclass(frozen=True, slots=True)
class Identity:
    """What an eRTIS says it is over USB.

    vendor_id, product_id : int
        0483:5740 is what ST's example firmware uses, and not confirmed for every board.
    product : str
        How its product string begins; empty for any. Many boards share ST's numbers.
    """

    vendor_id: int = 0x0483
    product_id: int = 0x5740
    product: str = "eRTIS"

    @property
    def usb_id(self) -> str:
        """``VID:PID`` in hex."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}"


ERTIS = Identity()


@dataclass(frozen=True, slots=True)
class Holder:
    """A process that has a port open."""

    pid: int
    command: str


@dataclass(frozen=True, slots=True)
class PluggedIn:
    """A USB device or a tty.

    port : str
        Its tty, such as ``/dev/ttyACM0``; empty if it has none, as when a ``usb:`` link holds it.
    usb_node : str
        Its file for ``usb:`` links, such as ``/dev/bus/usb/001/002``; empty if it is not on USB.
    vendor_id, product_id : int
        0 if it is not on USB.
    product, serial_number : str
        As the device says; empty if it does not.
    bus, address : int
        Place on USB; the address changes with every replug.
    sysfs : str
        Its folder's name in /sys/bus/usb/devices, such as ``1-1``.
    holders : tuple of Holder
        Who has it open, as far as this user may see: root sees all, others their own.
    may_open : bool
        Whether permissions let this process open ``port``, or ``usb_node`` if there is no port.
    """

    port: str = ""
    usb_node: str = ""
    vendor_id: int = 0
    product_id: int = 0
    product: str = ""
    serial_number: str = ""
    bus: int = 0
    address: int = 0
    sysfs: str = ""
    holders: tuple[Holder, ...] = ()
    may_open: bool = False

    @property
    def usb_id(self) -> str:
        """``VID:PID`` in hex, or empty."""
        return f"{self.vendor_id:04x}:{self.product_id:04x}" if self.usb_node else ""

    def why_not(self, identity: Identity = ERTIS) -> str:
        """Why it is not an eRTIS, or empty if it is."""
        if not self.usb_node:
            return "not on USB"
        if self.usb_id != identity.usb_id:
            return f"USB {self.usb_id}, expected {identity.usb_id}"
        if not self.product.startswith(identity.product):
            return f"product {self.product!r}, expected {identity.product!r}"
        return ""

    def __str__(self) -> str:
        """For messages: place, name and serial number."""
        where = self.port or self.usb_node
        number = f"serial number {self.serial_number}" if self.serial_number else "no serial number"
        return " ".join(part for part in (where, self.usb_id, self.product, f"({number})") if part)


def plugged_in() -> list[PluggedIn]:
    """Every tty of a device, and every USB device without one, with who holds it.

    Hubs, and the kernel's own ports that nothing is behind, are left out.
    """
    usb = {device.sysfs: device for device in usb_devices()}
    found = []
    with_port = set()
    for port in sorted(_ports(), key=lambda port: str(port.device)):
        name = _usb_name(port)
        with_port.add(name)
        found.append(replace(usb.get(name, PluggedIn()), port=str(port.device)))
    found += [device for name, device in usb.items() if name not in with_port]
    held = _open_files()
    return [_examined(device, held) for device in found]


def usb_devices() -> list[PluggedIn]:
    """Every USB device but hubs, from sysfs: needs no permission, and opens nothing."""
    devices = []
    for folder in sorted(SYS_USB.glob("*")) if SYS_USB.is_dir() else []:
        bus, address = _number(folder, "busnum", 10), _number(folder, "devnum", 10)
        if not address or _number(folder, "bDeviceClass", 16) == 9:  # interfaces; hubs
            continue
        devices.append(
            PluggedIn(
                usb_node=f"/dev/bus/usb/{bus:03d}/{address:03d}",
                vendor_id=_number(folder, "idVendor", 16),
                product_id=_number(folder, "idProduct", 16),
                product=_text(folder, "product"),
                serial_number=_text(folder, "serial"),
                bus=bus,
                address=address,
                sysfs=folder.name,
            )
        )
    return devices


def find_port(where: str) -> str:
    """Return the port of a ``serial:`` address: a path as it is, ``sn=ABC`` looked up.

    Raises
    ------
    AddressError
        If several ports have that serial number.
    DeviceNotFound
        If none has.
    """
    if not where.startswith(SERIAL_MARK):
        return where
    number = where.removeprefix(SERIAL_MARK)
    ports = {
        str(port.device): port.serial_number
        for port in _ports()
        if port.serial_number  # an empty number matches nothing
    }
    met = [port for port, its in ports.items() if its == number]
    if len(met) > 1:
        raise AddressError(
            f"serial number {number} is that of {' and '.join(sorted(met))}: name the port"
        )
    if not met:
        seen = ", ".join(f"{its} at {port}" for port, its in sorted(ports.items()))
        raise DeviceNotFound(
            f"no serial port with serial number {number} (plugged in: {seen or 'none'}): check "
            "cable and power; `ertis devices --all` says more"
        )
    return met[0]


def pinned(address: str) -> str:
    """Return an address that finds the same device again after it was replugged.

    A port becomes ``serial:sn=...`` and ``usb:VID:PID`` gets its serial number. What has no serial
    number, or shares it, keeps its address.
    """
    kind, _, where = address.partition(":")
    if kind == "serial":
        names = (where, os.path.realpath(where))  # udev's symlinks
        ports = _ports()
        number = next((port.serial_number for port in ports if port.device in names), None)
        if number and sum(port.serial_number == number for port in ports) == 1:
            return f"serial:{SERIAL_MARK}{number}"
    elif kind == "usb":
        met = [device for device in usb_devices() if device.usb_id == where.lower()]
        if len(met) == 1 and met[0].serial_number:
            return f"usb:{met[0].usb_id}:{met[0].serial_number}"
    return address


def holders_of(paths: Iterable[str]) -> tuple[Holder, ...]:
    """Which other processes have one of these files open, as far as this user may see."""
    return _holders(paths, _open_files())


def _examined(device: PluggedIn, held: dict[str, set[int]]) -> PluggedIn:
    paths = [path for path in (device.port, device.usb_node) if path]
    may_open = os.access(paths[0], os.R_OK | os.W_OK)
    return replace(device, holders=_holders(paths, held), may_open=may_open)


def _holders(paths: Iterable[str], held: dict[str, set[int]]) -> tuple[Holder, ...]:
    pids: set[int] = set().union(*(held.get(path, ()) for path in paths))
    return tuple(Holder(pid, _command(pid)) for pid in sorted(pids - {os.getpid()}))


def _open_files() -> dict[str, set[int]]:
    """Which processes have which file open."""
    held: dict[str, set[int]] = {}
    for folder in Path("/proc").glob("[0-9]*/fd"):
        with suppress(OSError):  # gone by now, or another user's
            for entry in list(folder.iterdir()):
                with suppress(OSError):
                    held.setdefault(str(entry.readlink()), set()).add(int(folder.parent.name))
    return held


def _command(pid: int) -> str:
    try:
        line = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return "?"
    return line.rstrip(b"\0").replace(b"\0", b" ").decode(errors="replace")


def _ports() -> list[Any]:
    for _ in range(LISTING_ATTEMPTS - 1):
        with suppress(OSError, TypeError, ValueError):
            return list(list_ports.comports())
        time.sleep(LISTING_PAUSE_S)
    return list(list_ports.comports())


def _usb_name(port: Any) -> str:
    path = getattr(port, "usb_device_path", None)  # only what is on USB has one
    return Path(path).name if path else ""


def _text(folder: Path, name: str) -> str:
    try:
        return (folder / name).read_text(errors="replace").strip()
    except OSError:  # it has none, or went away
        return ""


def _number(folder: Path, name: str, base: int) -> int:
    text = _text(folder, name)
    return int(text, base) if text else 0
