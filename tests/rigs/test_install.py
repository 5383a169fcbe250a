"""``make install`` and ``make uninstall`` on a clean tree, in a QEMU guest under systemd.

As on a robot without a network: the wheels are there, and pip is told so by its environment.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from qemu.kernel import CHECKOUT, NoGuest
from qemu.machine import boot

pytestmark = [pytest.mark.slow, pytest.mark.index]

PYTHON = "/usr/bin/python3"
FETCH_S = 400
GUEST_S = 900
MEMORY_MB = 2048  # what is installed lies in it: 300 MB
INSTALLED = {
    "/opt/ertis",
    "/usr/local/bin/ertis",
    "/etc/ertis",
    "/etc/ertis/ertis.yaml",
    "/etc/systemd/system/ertis-daemon.service",
    "/etc/systemd/system/ertis-daemon@.service",
    "/etc/udev/rules.d/70-ertis.rules",
}
# An emulated machine takes minutes to import what a robot imports in a second.
PATIENCE = """[Service]
TimeoutStartSec=900s
WatchdogSec=300s
TimeoutStopSec=60s
"""


def fetch_wheels(folder, tree):
    """All that pip needs for the tree, as wheels in a folder."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    pip = folder / "venv/bin/pip"
    for command in (
        [PYTHON, "-m", "venv", folder / "venv"],
        [pip, "download", "-q", "-d", folder / "wheels", "hatchling", f"{tree}[ros2]"],
    ):
        try:
            done = subprocess.run(
                command,
                env=environment,
                capture_output=True,
                text=True,
                timeout=FETCH_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            pytest.skip(f"the package index did not deliver what to install in {FETCH_S} s")
        if re.search(
            "No matching distribution|Could not find|ensurepip", done.stderr + done.stdout
        ):
            pytest.skip(f"nothing to install from: {done.stderr.strip()[-300:]}")
        assert done.returncode == 0, done.stderr[-3000:]
    return folder / "wheels"


@pytest.fixture(scope="module")
def guest(tmp_path_factory):
    """One boot for all tests; what was seen is left in out/install.txt."""
    if not Path("/lib/systemd/systemd").exists():
        pytest.skip("no systemd to boot the guest with: apt install systemd udev")
    if not Path(PYTHON).exists():
        pytest.skip(f"no {PYTHON}, which is the Python that a service may see")
    stage = tmp_path_factory.mktemp("stage")
    tree = stage / "srv/ertis"
    shutil.copytree(CHECKOUT, tree, ignore=shutil.ignore_patterns(".*", "__pycache__", "out"))
    wheels = fetch_wheels(tmp_path_factory.mktemp("fetched"), tree)
    wheels.rename(stage / "srv/wheels")
    drop_in = stage / "etc/systemd/system/ertis-daemon.service.d/emulated.conf"
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(PATIENCE)
    try:
        run = boot(
            ["-m", "qemu.inside.installing", "/srv/ertis", "/srv/wheels", PYTHON],
            stage=stage,
            memory_mb=MEMORY_MB,
            timeout_s=GUEST_S,
        )
    except NoGuest as reason:
        pytest.skip(str(reason))
    transcript = CHECKOUT / "out" / "install.txt"
    transcript.parent.mkdir(exist_ok=True)
    transcript.write_text(run.console)
    return run


def found(guest, step):
    end = f"{'killed' if guest.timed_out else 'off'} after {guest.seconds:.0f} s"
    assert step in guest.results, f"no end of {step}; guest {end}:\n{guest.console[-3000:]}"
    return guest.results[step]


def test_make_install_on_a_clean_tree_needs_nothing_but_wheels(guest, capsys):
    install = found(guest, "install")
    assert install["code"] == 0, install["said"]
    assert "systemctl enable --now ertis-daemon" in install["said"]
    appeared = found(guest, "appeared")
    assert set(appeared["entries"]) == INSTALLED
    with capsys.disabled():
        print(f"\nmake install: {install['seconds']} s, {appeared['bytes'] / 1e6:.0f} MB", end=" ")


def test_the_command_is_there_and_the_unit_is_one(guest):
    assert found(guest, "command")["said"].startswith("ertis ")
    assert found(guest, "verify")["code"] == 0, found(guest, "verify")["said"]


def test_the_service_becomes_ready_and_waits_for_its_sonar(guest):
    assert found(guest, "start")["code"] == 0, found(guest, "start")["said"]
    status = found(guest, "status")["said"]
    assert "Active: active (running)" in status
    assert 'Status: "ertis: waiting, DeviceNotFound' in status


def test_make_uninstall_stops_the_service_and_leaves_nothing_but_its_state(guest):
    uninstall = found(guest, "uninstall")
    assert uninstall["code"] == 0, uninstall["said"]
    # systemd's StateDirectory is where recordings are: they stay.
    assert set(found(guest, "left")["entries"]) <= {"/var/lib/ertis", "/var/lib/private"}
    assert found(guest, "gone")["code"] == 4, "systemd knows no such unit"
