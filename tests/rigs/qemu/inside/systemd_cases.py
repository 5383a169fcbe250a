"""Cases under systemd: the installed units, started by udev for a sonar that is plugged in."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from qemu.inside.board import Board

SERIAL = "ERTIS001"
UNIT = f"ertis-daemon@{SERIAL}.service"
START_S = 400  # an emulated machine takes half a minute to import numpy and zenoh


def service_life() -> dict:
    """Plugged in, hanging, pulled out, plugged in again, stopped: what systemd makes of it."""
    found: dict = {"before": _state()}
    with Board(serial_number=SERIAL) as board:
        found["plugged"] = _until("active")
        found["name"] = str(Path(f"/dev/ertis-{SERIAL}").resolve())
        found["process"] = _process()
        found["working"] = _working()
        found["security"] = _run("systemd-analyze", "security", "--no-pager", UNIT).splitlines()[-1]
        os.kill(_pid(), signal.SIGSTOP)  # it hangs, whatever the reason
        found["hung"] = _until_restarted(1)
        found["after_hang"] = _until("active")
        board.unplug()
        found["unplugged"] = _until("inactive")
        found["name_gone"] = not Path(f"/dev/ertis-{SERIAL}").exists()
        board.plug()
        found["replugged"] = _until("active")
        found["working_again"] = _working()
        started_s = time.monotonic()
        _run("systemctl", "stop", UNIT)
        found["stopped"] = {"seconds": _since(started_s)} | _show("Result", "ExecMainStatus")
    found["journal"] = _run("journalctl", "--no-pager", "-o", "short-monotonic", "-u", UNIT)
    return found


def without_a_configuration() -> dict:
    """A sonar that nobody wrote a configuration for is left alone."""
    other = "ERTIS002"
    unit = f"ertis-daemon@{other}.service"
    with Board(serial_number=other):
        deadline_s = time.monotonic() + 30
        while not Path(f"/dev/ertis-{other}").exists() and time.monotonic() < deadline_s:
            time.sleep(0.1)
        while _show("ConditionTimestampMonotonic", unit=unit)["ConditionTimestampMonotonic"] == "0":
            time.sleep(0.1)
            if time.monotonic() > deadline_s:
                break
        return _show("ActiveState", "ConditionResult", "Result", unit=unit)


def _until(state: str) -> dict:
    """Wait for a state of the unit; how long it took."""
    started_s = time.monotonic()
    while (met := _state()) != state:
        if time.monotonic() - started_s > START_S:
            journal = _run("journalctl", "--no-pager", "-o", "short-monotonic", "-n", "30")
            raise TimeoutError(f"{met}, expected {state}, after {START_S} s:\n{journal}")
        time.sleep(0.1)
    return {"state": met, "seconds": _since(started_s)}


def _until_restarted(times: int) -> dict:
    """Wait until systemd has started the unit again; why, is told only until it has."""
    started_s = time.monotonic()
    results = set()
    while int((met := _show("NRestarts", "Result"))["NRestarts"]) < times:
        results.add(met["Result"])
        if time.monotonic() - started_s > START_S:
            break
        time.sleep(0.1)
    return {
        "restarts": int(met["NRestarts"]),
        "results": sorted(results - {"success"}),
        "seconds": _since(started_s),
    }


def _working() -> str:
    """Status as the daemon tells it, once it says that pings come."""
    started_s = time.monotonic()
    while "running" not in (met := _show("StatusText")["StatusText"]):
        if time.monotonic() - started_s > START_S:
            break
        time.sleep(0.2)
    return met


def _process() -> dict:
    lines = Path(f"/proc/{_pid()}/status").read_text().splitlines()
    fields = dict(line.split(":\t", 1) for line in lines if ":\t" in line)
    return {
        "uid": int(fields["Uid"].split()[0]),
        "groups": fields["Groups"].split(),
        "capabilities": fields["CapEff"],
        "seccomp": fields["Seccomp"],
        "resident_mb": round(int(fields["VmRSS"].split()[0]) / 1024),
    }


def _pid() -> int:
    return int(_show("MainPID")["MainPID"])


def _state() -> str:
    return _show("ActiveState")["ActiveState"]


def _show(*names: str, unit: str = UNIT) -> dict[str, str]:
    wanted = [f"--property={name}" for name in names]
    lines = _run("systemctl", "show", *wanted, unit).splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line)


def _run(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, timeout=60).stdout


def _since(started_s: float) -> float:
    return round(time.monotonic() - started_s, 1)


CASES = (service_life, without_a_configuration)
