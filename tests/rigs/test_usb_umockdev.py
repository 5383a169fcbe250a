"""The usb: link through real pyusb and libusb, on a device that umockdev emulates, and its tty.

The firmware behind it is our emulator; see umock/.
"""

import json
import os
import sys
import zlib

import pytest
from umock import rig

from ertis_driver.emulator import Emulator

REASON = rig.why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))

ADDRESS = "usb:0483:5740"
AT = 51_300  # in mid-frame, and in mid-packet
IMPATIENT = {"timeout_s": 1.5, "frame_timeout_s": 1.5}


def device(emulator, kind="none", serial="ERTIS001", **fault):
    return {
        "port": emulator.path,
        "serial": serial,
        "product": "eRTIS",
        "fault": {"kind": kind, "at": AT, "ping": 1} | fault,
    }


def assert_frame(met, source, index):
    words = source.words(index, 32_768, active=True)
    assert met == ["frame", index, zlib.crc32(words.tobytes())]


def asked(log):
    return [tuple(entry) for entry in log]


@pytest.mark.parametrize(
    ("address", "system_libusb"),
    [(ADDRESS, True), ("usb:483:5740:ERTIS001", False), ("usb:sn=ERTIS001", True)],
)
def test_pings_arrive_bit_for_bit_by_every_form_of_address_and_either_libusb(
    emulator, source, tmp_path, address, system_libusb
):
    met, _ = rig.ping(address, 3, [device(emulator)], tmp_path, system_libusb=system_libusb)
    assert met[0] == ["open", address]
    for index in range(3):
        assert_frame(met[1 + index], source, index)


def test_both_interfaces_are_claimed_and_given_back_to_the_kernels_driver(emulator, tmp_path):
    _, (log,) = rig.ping(ADDRESS, 1, [device(emulator)], tmp_path)
    line_coding, dtr_on, dtr_off = (
        "212000000000070000c20100000008",
        "2122030000000000",
        "2122000000000000",
    )
    assert asked(log) == [
        ("detach", 0),
        ("claim", 0),
        ("claim", 1),
        ("control", line_coding),
        ("control", dtr_on),
        ("control", dtr_off),
        ("release", 0),
        ("release", 1),
        ("attach", 0),
    ]


def test_firmware_that_declines_line_coding_is_used_all_the_same(emulator, source, tmp_path):
    met, _ = rig.ping(ADDRESS, 1, [device(emulator, "no_line")], tmp_path)
    assert_frame(met[1], source, 0)


def test_a_short_packet_in_mid_frame_costs_nothing(emulator, source, tmp_path):
    met, (log,) = rig.ping(ADDRESS, 3, [device(emulator, "short")], tmp_path)
    assert ("fault", "short") in asked(log)
    for index in range(3):
        assert_frame(met[1 + index], source, index)


@pytest.mark.parametrize(
    ("kind", "error"),
    [
        ("stall", "DeviceTimeout|FrameCorrupt"),
        ("babble", "FrameCorrupt"),
        ("stop", "FrameCorrupt"),
    ],
)
def test_a_damaged_frame_costs_itself_alone(emulator, source, tmp_path, kind, error):
    met, (log,) = rig.ping(ADDRESS, 3, [device(emulator, kind)], tmp_path, **IMPATIENT)
    assert_frame(met[1], source, 0)
    assert met[2][0] in error.split("|")
    assert "ping again" in met[2][1]
    assert_frame(met[3], source, 2)
    assert ("fault", kind) in asked(log)
    assert (("clear_halt", 0x81) in asked(log)) is (kind != "stop")


def test_a_device_that_sends_nothing_times_out_and_the_next_ping_is_whole(
    emulator, source, tmp_path
):
    met, _ = rig.ping(ADDRESS, 3, [device(emulator, "stop", at=0)], tmp_path, **IMPATIENT)
    assert met[2][0] == "DeviceTimeout"
    assert_frame(met[3], source, 2)


@pytest.mark.parametrize(
    ("kind", "at"),
    [("unplug", 0), ("unplug", 512), ("unplug", AT), ("unplug", 131_083), ("eproto", AT)],
)
def test_a_device_that_goes_away_at_any_byte_is_lost(emulator, source, tmp_path, kind, at):
    met, _ = rig.ping(ADDRESS, 3, [device(emulator, kind, at=at)], tmp_path, **IMPATIENT)
    assert_frame(met[1], source, 0)
    assert [its[0] for its in met[2:4]] == ["DeviceLost", "DeviceLost"]
    assert "went away" in met[2][1]
    assert "reopen" in met[2][1]


def test_a_replugged_device_is_opened_again_by_its_serial_number(emulator, source, tmp_path):
    plan = device(emulator, "unplug", replug_s=0.5)
    met, (before, after) = rig.ping(ADDRESS, 4, [plan], tmp_path, reconnect=True, patience_s=20)
    assert_frame(met[1], source, 0)
    assert met[2][0] == "PingLost"
    assert "ping again" in met[2][1]
    assert_frame(met[3], source, 2)
    assert_frame(met[4], source, 3)
    assert met[5] == ["reconnects", 1]
    assert ("fault", "unplug") in asked(before)
    assert asked(after)[:3] == asked(before)[:3]


@pytest.mark.parametrize("address", ["serial:/dev/ttyACM0", "serial:sn=ERTIS001"])
def test_a_replugged_tty_is_found_under_its_new_name(emulator, source, tmp_path, address):
    plan = device(emulator, "unplug", replug_s=0.5)  # it comes back as ttyACM1
    met, _ = rig.ping(address, 4, [plan], tmp_path, reconnect=True, patience_s=20)
    assert met[0] == ["open", address]
    assert_frame(met[1], source, 0)
    assert met[2][0] == "PingLost"
    assert "/dev/ttyACM0 went away" in met[2][1]
    assert_frame(met[3], source, 2)
    assert_frame(met[4], source, 3)
    assert met[5] == ["reconnects", 1]


def test_an_interface_that_another_process_claims_is_busy(emulator, tmp_path):
    met, (log,) = rig.ping(ADDRESS, 1, [device(emulator, "busy")], tmp_path)
    assert met[0][0] == "DeviceBusy"
    assert ("attach", 0) in asked(log), "the kernel gets its interfaces back"


def test_without_permission_the_udev_rule_is_named(emulator, tmp_path):
    met, _ = rig.ping(
        ADDRESS, 1, [device(emulator, mode=0)], tmp_path, prefix=without_roots_privilege()
    )
    assert met[0][0] == "DevicePermission"
    assert "udev rule" in met[0][1]


def test_a_device_that_is_not_there_is_not_found_and_the_message_says_what_is(emulator, tmp_path):
    for address in ("usb:1234:5678", "usb:0483:5740:OTHER", "usb:sn=OTHER"):
        met, _ = rig.ping(address, 1, [device(emulator)], tmp_path)
        assert met[0][0] == "DeviceNotFound"
        assert address in met[0][1]
        assert "ERTIS001" in met[0][1]


def test_of_two_devices_the_serial_numbers_are_listed_and_each_can_be_named(
    emulator, source, tmp_path
):
    with Emulator(source) as another:
        devices = [device(emulator, serial="FIRST"), device(another, serial="SECOND")]
        met, _ = rig.ping(ADDRESS, 1, devices, tmp_path)
        assert met[0][0] == "AddressError"
        assert "FIRST" in met[0][1]
        assert "SECOND" in met[0][1]
        met, (first, second) = rig.ping(f"{ADDRESS}:SECOND", 1, devices, tmp_path)
    assert_frame(met[1], source, 0)
    assert not asked(first)
    assert asked(second)


def test_devices_lists_the_sonar_by_default_and_the_reason_for_any_other(emulator, tmp_path):
    other = device(emulator, serial="X") | {"vendor": "2341", "product": "Uno"}
    foreign = device(emulator, serial="Y") | {"product": "STM32 Virtual ComPort"}
    command = [sys.executable, "-m", "ertis_daemon.cli", "devices", "--json"]
    done, _ = rig.run(command, [device(emulator), other, foreign], tmp_path)
    (met,) = json.loads(done.stdout)
    assert (met["port"], met["serial_number"], met["usb_id"], met["product"]) == (
        "/dev/ttyACM0",
        "ERTIS001",
        "0483:5740",
        "eRTIS",
    )
    assert (met["usb_node"], met["may_open"], met["is_sonar"]) == (
        "/dev/bus/usb/001/002",
        True,
        True,
    )
    done, _ = rig.run([*command, "--all"], [device(emulator), other, foreign], tmp_path)
    reasons = {met["serial_number"]: met["why_not"] for met in json.loads(done.stdout)}
    assert reasons["ERTIS001"] == ""
    assert reasons["X"] == "USB 2341:5740, expected 0483:5740"
    assert reasons["Y"] == "product 'STM32 Virtual ComPort', expected 'eRTIS'"


def test_devices_without_permission_says_what_to_do(emulator, tmp_path):
    command = [sys.executable, "-m", "ertis_daemon.cli", "devices"]
    plan = [device(emulator, mode=0)]
    done, _ = rig.run([*without_roots_privilege(), *command], plan, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "make udev" in done.stdout


def without_roots_privilege():
    if os.geteuid():
        return []
    drop = "-dac_override,-dac_read_search"
    return ["setpriv", f"--bounding-set={drop}", f"--inh-caps={drop}"]
