"""Cases on ``serial:``, over the kernel's cdc-acm."""

from __future__ import annotations

import os
import subprocess
import sys

from ertis_driver.open import open_device
from qemu.inside.board import Board
from qemu.inside.looking import acm_ports, wait_for, wait_for_port
from qemu.inside.pinging import PATIENT, QUICK, coming_back, configured, listening, losing

SERIAL_PORTS = "/dev/ttyACM"


def serial_pings() -> dict:
    """Twenty default pings."""
    with Board(), open_device(f"serial:{wait_for_port()}", **PATIENT) as device:
        return configured(device) | listening(device, 20)


def serial_unplug() -> dict:
    """It vanishes in mid-frame; what is left open?"""
    with Board() as board:
        return losing(board, f"serial:{wait_for_port()}", SERIAL_PORTS)


def serial_replug() -> dict:
    """It vanishes in mid-frame and comes back."""
    with Board() as board:
        return coming_back(board, f"serial:{wait_for_port()}", SERIAL_PORTS)


def serial_replug_renamed() -> dict:
    """As ``serial_replug``, while somebody holds the port, dead or alive: its name is taken."""
    with Board() as board:
        port = wait_for_port()
        holder = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            result = coming_back(board, f"serial:{port}", SERIAL_PORTS)
            return result | {"ports": acm_ports()}
        finally:
            os.close(holder)


def devices() -> dict:
    """What ``ertis devices`` says of a sonar, and of another board with the same numbers."""
    other = {"serial_number": "X7", "product": "Other board", "socket": 1}
    with Board():
        wait_for_port()  # the kernel numbers boards as it meets them, not as they are plugged in
        with Board(**other):
            wait_for(lambda: wait_for_port() == "/dev/ttyACM1")
            with open_device("serial:/dev/ttyACM0", **PATIENT) as device:
                device.configure(QUICK)
                return _ertis("devices", "--all")


def probe() -> dict:
    """What ``ertis probe`` says of a board whose microphones hear white noise."""
    with Board():
        return _ertis("probe", f"serial:{wait_for_port()}", "--pings", "3")


def _ertis(*arguments: str) -> dict:
    command = [sys.executable, "-m", "ertis_daemon.cli", *arguments]
    run = subprocess.run(command, capture_output=True, text=True, timeout=80)
    return {"exit": run.returncode, "stdout": run.stdout, "stderr": run.stderr}


CASES = (serial_pings, serial_unplug, serial_replug, serial_replug_renamed, devices, probe)
