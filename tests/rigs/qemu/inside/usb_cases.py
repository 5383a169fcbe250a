"""Cases on ``usb:``, over libusb: past cdc-acm, and on a device that can do all that USB can."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

from ertis_driver.discover import usb_devices
from ertis_driver.errors import FrameCorrupt
from ertis_driver.open import open_device
from qemu.inside.board import Board
from qemu.inside.firmware import Deaf, Pieces, Stall, Surplus
from qemu.inside.looking import acm_ports, open_files, wait_for, wait_for_no_port, wait_for_port
from qemu.inside.pinging import PATIENT, QUICK, as_sent, coming_back, configured, listening, losing

ADDRESS = "usb:0483:5740:ERTIS001"
USB_NODES = "/dev/bus/usb"


def usb_pings() -> dict:
    """Twenty default pings; the kernel's port goes and comes back, and works."""
    with Board():
        before = wait_for_port()
        with open_device(ADDRESS, **PATIENT) as device:
            wait_for_no_port()
            result = configured(device) | listening(device, 20)
        after = wait_for_port()
        with open_device(f"serial:{after}", **PATIENT) as device:
            device.configure(QUICK)
            serial = listening(device, 3)
    return result | {"port_before": before, "port_after": after, "serial_after": serial}


def usb_unplug() -> dict:
    """It vanishes in mid-frame; what is left open?"""
    with Board() as board:
        wait_for_port()
        return losing(board, ADDRESS, USB_NODES, at=(0, 60_000))


def usb_replug() -> dict:
    """It vanishes in mid-frame and comes back."""
    with Board() as board:
        wait_for_port()
        return coming_back(board, ADDRESS, USB_NODES)


def two_sonars() -> dict:
    """One on each link, in one process, at the same time."""
    with Board(), Board("ffs", "ERTIS002", socket=1):
        addresses = f"serial:{wait_for_port()}", _wait_for_ffs("ERTIS002")
        with ThreadPoolExecutor() as pool:
            return dict(zip(("serial", "usb"), pool.map(_ping_five, addresses), strict=True))


def usb_stall() -> dict:
    """The endpoint halts in mid-frame."""
    return _faulty(Stall(at=50_000))


def usb_stall_first() -> dict:
    """The endpoint halts before the frame."""
    return _faulty(Stall(at=0))


def usb_deaf() -> dict:
    """The endpoint for commands halts after a ping."""
    return _faulty(Deaf())


def usb_short_packets() -> dict:
    """A frame in transfers of every awkward size, some of them empty."""
    return _faulty(Pieces((8, 0, 2048, 1, 511, 512, 513, 3, 0, 0, 65_536)))


def usb_surplus() -> dict:
    """Rubbish in the same packets as the first and the last bytes of the frame."""
    return _faulty(Surplus(before=1000, behind=3000))


def usb_babble() -> dict:
    """A program that asks for less than a packet is swamped; then ours opens the device."""
    with Board("ffs"):
        _wait_for_ffs()
        # A process of its own: it leaves what it was doing unfinished.
        command = [sys.executable, "-m", "qemu.inside.impatient"]
        other = subprocess.run(command, capture_output=True, text=True, timeout=50)
        with open_device(ADDRESS, **PATIENT) as device:
            device.configure(QUICK)
            return {"other": other.stdout + other.stderr, "as_sent": as_sent(device.ping())}


def usb_ffs_unplug() -> dict:
    """The FunctionFS device vanishes in mid-frame, in the middle of a transfer."""
    with Board("ffs") as board:
        return losing(board, _wait_for_ffs(), USB_NODES)


def usb_ffs_replug() -> dict:
    """The FunctionFS device vanishes in mid-frame and comes back."""
    with Board("ffs") as board:
        return coming_back(board, _wait_for_ffs(), USB_NODES)


def _faulty(fault) -> dict:
    """A good ping, one with the fault, a good one: what came of each."""
    outcomes = []
    with Board("ffs") as board, open_device(_wait_for_ffs(), **PATIENT) as device:
        device.configure(QUICK)
        for index in range(3):
            if index == 1:
                board.misbehave(fault)
            try:
                frame = device.ping()
            except FrameCorrupt as error:
                outcomes.append(f"{type(error).__name__}: {error}")
                continue
            same = frame.ping_index == index and as_sent(frame)
            outcomes.append("as sent" if same else "NOT as sent")
    return {"outcomes": outcomes, "ports": acm_ports(), "held": open_files(USB_NODES)}


def _ping_five(address: str) -> dict:
    with open_device(address, **PATIENT) as device:
        device.configure(QUICK)
        return listening(device, 5)


def _wait_for_ffs(serial_number: str = "ERTIS001") -> str:
    wait_for(lambda: [its for its in usb_devices() if its.serial_number == serial_number])
    return f"usb:0483:5740:{serial_number}"


CASES = (
    usb_pings,
    usb_unplug,
    usb_replug,
    two_sonars,
    usb_stall,
    usb_stall_first,
    usb_deaf,
    usb_short_packets,
    usb_babble,
    usb_surplus,
    usb_ffs_unplug,
    usb_ffs_replug,
)
