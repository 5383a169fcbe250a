"""The udev rule, through udev's own rule engine, on a device that umockdev emulates."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from umock import rig

TOP = Path(__file__).parents[2]
RULES = TOP / "udev" / "70-ertis.rules"
NAMESPACE = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"])]
USB = "/sys/devices/pci0000:00/usb1/1-1"
TTY = f"{USB}/1-1:1.0/tty/ttyACM0"


def why_not():
    if rig.why_not():
        return rig.why_not()
    if shutil.which("udevadm") is None:
        return "no udevadm: apt install udev"
    if subprocess.run([*NAMESPACE, "true"], capture_output=True, check=False).returncode:
        return "no mount namespaces here: run as root"
    return None


REASON = why_not()
needs_udev = pytest.mark.skipif(REASON is not None, reason=str(REASON))


def udevadm_test(emulator, path, folder, product="eRTIS", serial="ERTIS001"):
    """What udev would do: properties by name, and what our own rule did, in udev's words."""
    plan = {"port": emulator.path, "serial": serial, "product": product}
    script = str(rig.HERE / "private_udev.sh")
    before = sorted(Path("/dev").glob("ertis-*"))
    done, _ = rig.run(
        [*NAMESPACE, "sh", script, str(RULES), "udevadm", "test", "--action=add", path],
        [plan],
        folder,
    )
    assert done.returncode == 0, done.stderr
    assert sorted(Path("/dev").glob("ertis-*")) == before, "the real /dev stays as it is"
    assert "Invalid" not in done.stderr
    properties = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    ours = [line.split(" ", 2)[2] for line in done.stderr.splitlines() if f"/{RULES.name}:" in line]
    return properties, ours


@needs_udev
def test_the_tty_gets_name_group_mode_seat_and_daemon_and_is_left_alone_by_modemmanager(
    emulator, tmp_path
):
    properties, ours = udevadm_test(emulator, TTY, tmp_path)
    assert "/dev/ertis-ERTIS001" in properties["DEVLINKS"].split()
    assert properties["ID_MM_DEVICE_IGNORE"] == "1"
    assert properties["SYSTEMD_WANTS"] == "ertis-daemon@ERTIS001.service"
    assert {"uaccess", "systemd"} <= set(properties["TAGS"].split(":"))
    assert "MODE 0660" in ours
    dialout = next(
        line for line in Path("/etc/group").read_text().splitlines() if line.startswith("dialout:")
    )
    assert f"GROUP {dialout.split(':')[2]}" in ours


@needs_udev
def test_the_usb_device_is_opened_to_the_same_people(emulator, tmp_path):
    properties, ours = udevadm_test(emulator, USB, tmp_path)
    assert "MODE 0660" in ours
    assert any(line.startswith("GROUP ") for line in ours)
    assert "uaccess" in properties["TAGS"].split(":")
    assert properties["ID_MM_DEVICE_IGNORE"] == "1"


@needs_udev
@pytest.mark.parametrize("path", [USB, TTY])
def test_another_board_with_the_same_numbers_is_left_alone(emulator, tmp_path, path):
    properties, ours = udevadm_test(emulator, path, tmp_path, product="STM32 Virtual ComPort")
    assert ours == []
    assert "SYSTEMD_WANTS" not in properties
    assert "ertis" not in properties.get("DEVLINKS", "")


def test_it_is_numbered_between_the_rules_it_builds_on_and_those_that_act_on_it():
    assert "60-serial.rules" < RULES.name < "73-seat-late.rules"


def test_make_udev_puts_it_where_udev_looks(tmp_path):
    subprocess.run(["make", "-s", "udev", f"DESTDIR={tmp_path}"], cwd=TOP, check=True)
    met = tmp_path / "etc" / "udev" / "rules.d" / RULES.name
    assert met.read_text() == RULES.read_text()
    assert met.stat().st_mode & 0o777 == 0o644
