"""``make install`` and ``make uninstall`` on a clean tree, in a QEMU guest under systemd.

As on a robot without a network: the wheels are there, and pip is told so by its environment.
"""

import shutil

import pytest
from qemu.kernel import CHECKOUT
from qemu.rig import PYTHON, boot_or_skip, found, run_from_index, skip_without_systemd

pytestmark = [pytest.mark.slow, pytest.mark.index]

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
    pip = folder / "venv/bin/pip"
    for command in (
        [PYTHON, "-m", "venv", folder / "venv"],
        [pip, "download", "-q", "-d", folder / "wheels", "hatchling", f"{tree}[ros2]"],
    ):
        run_from_index(
            command, limit_s=FETCH_S, unless="No matching distribution|Could not find|ensurepip"
        )
    return folder / "wheels"


@pytest.fixture(scope="module")
def guest(tmp_path_factory):
    """One boot for all tests; what was seen is left in out/install.txt."""
    skip_without_systemd()
    stage = tmp_path_factory.mktemp("stage")
    tree = stage / "srv/ertis"
    shutil.copytree(CHECKOUT, tree, ignore=shutil.ignore_patterns(".*", "__pycache__", "out"))
    wheels = fetch_wheels(tmp_path_factory.mktemp("fetched"), tree)
    wheels.rename(stage / "srv/wheels")
    drop_in = stage / "etc/systemd/system/ertis-daemon.service.d/emulated.conf"
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(PATIENCE)
    return boot_or_skip(
        ["-m", "qemu.inside.installing", "/srv/ertis", "/srv/wheels", PYTHON],
        "install.txt",
        stage=stage,
        memory_mb=MEMORY_MB,
        timeout_s=GUEST_S,
    )


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
