import os
import subprocess
import sys

import pytest

from ertis_driver.discover import (
    ERTIS,
    Holder,
    Identity,
    PluggedIn,
    find_port,
    holders_of,
    pinned,
    plugged_in,
)
from ertis_driver.errors import DeviceNotFound


def sonar(**changes):
    its = {
        "port": "/dev/ttyACM0",
        "usb_node": "/dev/bus/usb/001/002",
        "vendor_id": 0x0483,
        "product_id": 0x5740,
        "product": "eRTIS v3D1",
        "serial_number": "ERTIS001",
    }
    return PluggedIn(**(its | changes))


def test_an_ertis_is_known_by_its_numbers_and_its_product():
    assert sonar().why_not() == ""
    assert sonar(product="STM32 Virtual ComPort").why_not() == (
        "product 'STM32 Virtual ComPort', expected 'eRTIS'"
    )
    assert sonar(vendor_id=0x2341).why_not() == "USB 2341:5740, expected 0483:5740"
    assert PluggedIn(port="/dev/ttyS0").why_not() == "not on USB"


def test_what_an_ertis_says_can_be_told_to_be_something_else():
    other = Identity(0x2341, 0x0043, "")
    assert sonar().why_not(other) == "USB 0483:5740, expected 2341:0043"
    assert sonar(vendor_id=0x2341, product_id=0x43, product="any").why_not(other) == ""
    assert ERTIS.usb_id == "0483:5740"


def test_in_a_message_it_has_place_name_and_serial_number():
    assert str(sonar()) == "/dev/ttyACM0 0483:5740 eRTIS v3D1 (serial number ERTIS001)"
    assert str(PluggedIn(port="/dev/ttyS0")) == "/dev/ttyS0 (no serial number)"


def test_who_holds_a_file_is_found_with_its_command_but_not_we_ourselves(tmp_path):
    path = tmp_path / "port"
    path.touch()
    code = "import sys; file = open(sys.argv[1]); print('open', flush=True); sys.stdin.read()"
    with (
        path.open(),
        subprocess.Popen(
            [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as other,
    ):
        assert other.stdout.readline() == b"open\n"
        (holder,) = holders_of([str(path)])
        other.stdin.close()
    assert isinstance(holder, Holder)
    assert holder.pid == other.pid
    assert holder.command.endswith(str(path))
    assert holders_of([str(path)]) == ()


def test_a_path_is_a_port_as_it_is():
    assert find_port("/dev/ttyACM0") == "/dev/ttyACM0"
    assert find_port("sn") == "sn"


def test_an_unknown_serial_number_is_not_found():
    with pytest.raises(DeviceNotFound, match=r"serial number no-such-device.*ertis devices"):
        find_port("sn=no-such-device")


def test_what_has_no_serial_number_keeps_its_address():
    master, slave = os.openpty()
    try:
        for address in (f"serial:{os.ttyname(slave)}", "usb:ffff:ffff", "replay:a.mcap", "serial:"):
            assert pinned(address) == address
    finally:
        os.close(master)
        os.close(slave)


def test_the_list_can_be_made_anywhere():
    for device in plugged_in():
        assert device.port or device.usb_node
