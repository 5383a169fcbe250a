"""Starts a command with emulated USB devices in its /sys and /dev; the host's stay as they are."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
PYTHON = "/usr/bin/python3"  # Debian's gi belongs to Debian's python
PACKAGES = "apt install umockdev gir1.2-umockdev-1.0 python3-gi libusb-1.0-0"
TIMEOUT_S = 90  # the processes end themselves before, and say where they hang


def why_not():
    """Why the rig cannot run here, or None."""
    if shutil.which("umockdev-wrapper") is None:
        return f"no umockdev: {PACKAGES}"
    code = "import gi; gi.require_version('UMockdev', '1.0'); from gi.repository import UMockdev"
    if subprocess.run([PYTHON, "-c", code], capture_output=True, check=False).returncode:
        return f"no umockdev for {PYTHON}: {PACKAGES}"
    return None


def run(command, devices, folder):
    """Run ``command``; returns what it did, and what each device was asked."""
    spec, log = folder / "spec.json", folder / "log.json"
    spec.write_text(json.dumps({"command": command, "devices": devices, "log": str(log)}))
    done = subprocess.run(
        ["umockdev-wrapper", PYTHON, str(HERE / "server.py"), str(spec)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
        env={**os.environ, "PYTHONNOUSERSITE": "1"},
    )
    return done, json.loads(log.read_text()) if log.exists() else None


def ping(address, num_pings, devices, folder, *, prefix=(), **options):
    """Run ``job.py``; returns what it met, and what each device was asked."""
    command = [sys.executable, str(HERE / "job.py"), address, str(num_pings), json.dumps(options)]
    done, log = run([*prefix, *command], devices, folder)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), log
