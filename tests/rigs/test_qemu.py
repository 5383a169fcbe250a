"""Rig C: real cdc-acm, usbfs and libusb in a QEMU guest; see qemu/README.md."""

from functools import partial

import pytest
from qemu.machine import read_results
from qemu.rig import boot_or_skip
from qemu.rig import found as found_in

pytestmark = pytest.mark.slow

WHOLE = ["as sent", "as sent", "as sent"]  # a ping before the fault, with it, after it


@pytest.fixture(scope="module")
def guest():
    """One boot; also after a hang: what ended before it counts, what did not is missed below."""
    return boot_or_skip(["-m", "qemu.inside.job"], "qemu.txt")


@pytest.fixture
def found(guest):
    """What a case found in the guest."""
    return partial(found_in, guest)


@pytest.fixture
def say(capsys):
    """Prints figures, which nobody asserts on."""

    def write(name, result):
        with capsys.disabled():
            print(
                f"\n{name}: {result['frames_per_s']} frames/s, {result['mb_per_s']} MB/s, "
                f"{result['cpu_s_per_frame']} CPU s a frame (emulated machine)"
            )

    return write


def test_twenty_pings_over_cdc_acm_arrive_bit_for_bit(found, say):
    result = found("serial_pings")
    assert result["as_sent"] == 20
    assert result["indices"] == list(range(20))
    say("serial:", result)


def test_twenty_pings_over_libusb_arrive_bit_for_bit(found, say):
    result = found("usb_pings")
    assert result["as_sent"] == 20
    assert result["indices"] == list(range(20))
    say("usb:", result)


def test_the_kernels_port_is_given_back_after_usb_and_works(found):
    result = found("usb_pings")
    assert result["port_before"] == result["port_after"] == "/dev/ttyACM0"
    assert result["serial_after"]["as_sent"] == 3


def test_two_sonars_ping_at_the_same_time_in_one_process(found):
    result = found("two_sonars")
    assert result["serial"]["as_sent"] == result["usb"]["as_sent"] == 5


def test_devices_lists_the_sonar_with_its_holder_and_says_why_another_board_is_none(found):
    result = found("devices")
    assert result["exit"] == 0, result["stderr"]
    lines = {line.split()[0]: line for line in result["stdout"].splitlines() if line}
    sonar, other = lines["/dev/ttyACM0"], lines["/dev/ttyACM1"]
    assert "ERTIS001" in sonar
    assert "0483:5740" in sonar
    assert "eRTIS" in sonar
    assert "held by" in sonar
    assert "X7" in other
    assert "no sonar: product 'Other board'" in other


def test_probe_talks_to_it_and_hears_that_it_is_no_sonar_in_a_room(found):
    result = found("probe")
    assert result["exit"] == 3, result["stderr"]
    assert "2.3.4" in result["stdout"]
    assert "3 active, 1 passive" in result["stdout"]
    assert "direct path  not heard" in result["stdout"]


@pytest.mark.parametrize(
    ("case", "places"), [("serial_unplug", 4), ("usb_unplug", 2), ("usb_ffs_unplug", 4)]
)
def test_unplugged_anywhere_in_a_frame_it_is_lost_and_nothing_stays_open(found, case, places):
    result = found(case)
    assert result["as_sent_before"] == [True] * places
    assert result["held_before"] == [1] * places
    assert len(result["ended"]) == places
    for ended in result["ended"]:
        assert ended.startswith("DeviceLost: ")
        assert "reopen" in ended
    assert result["held_after"] == []


@pytest.mark.parametrize(
    "case", ["serial_replug", "serial_replug_renamed", "usb_replug", "usb_ffs_replug"]
)
def test_it_is_open_again_two_seconds_after_it_is_back_and_says_so_once(found, case, capsys):
    result = found(case)
    with capsys.disabled():
        print(
            f"\n{case}: open {result['reopened_s']} s after it is back, "
            f"heard {result['heard_again_s']} s after"
        )
    assert result["as_sent_before"] is True
    assert result["as_sent_after"] is True
    assert result["index_after"] == 2, "one frame was lost, and the device itself did not restart"
    assert result["reconnects"] == 1
    assert result["reopened_s"] <= 2.0
    gone, back = result["warnings"]
    assert "went away" in gone
    assert "is back" in back


def test_it_comes_back_under_its_old_name_because_nothing_was_left_open(found):
    assert found("serial_replug")["node_after"] == ["/dev/ttyACM0"]


def test_it_is_found_by_serial_number_when_somebody_holds_its_old_name(found):
    assert "/dev/ttyACM1" in found("serial_replug_renamed")["node_after"]
    assert found("serial_replug_renamed")["ports"] == ["/dev/ttyACM1"]


@pytest.mark.parametrize(
    "case", ["usb_stall", "usb_stall_first", "usb_deaf", "usb_short_packets", "usb_surplus"]
)
def test_frames_stay_whole_through_usb_faults(found, case):
    result = found(case)
    assert result["outcomes"] == WHOLE
    assert result["ports"] == [], "this device is for libusb alone"
    assert result["held"] == []


def test_a_device_that_another_program_left_babbling_pings_as_ever(found):
    result = found("usb_babble")
    assert result["other"] == "EOVERFLOW\n"
    assert result["as_sent"] is True


def test_a_guest_that_hangs_is_killed():
    run = boot_or_skip(["-c", "import time; print('waiting'); time.sleep(600)"], timeout_s=40)
    assert run.timed_out
    assert run.seconds < 60
    assert run.results == {}


def test_a_torn_line_of_results_is_left_out():
    assert read_results('{"a": {"b": 1}}\n{"c": {"d"') == {"a": {"b": 1}}
