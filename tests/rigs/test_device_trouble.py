"""Silent, half-silent, slow, babbling, late and stuttering devices, over a pty."""

import os
import threading
import time

import numpy as np
import pytest

from ertis_driver import protocol
from ertis_driver.clock import HostClock, read_clocks
from ertis_driver.device import Settings
from ertis_driver.emulator import Emulator
from ertis_driver.errors import (
    DeviceBabbles,
    DeviceError,
    DeviceTimeout,
    FrameCorrupt,
    NotConfigured,
)
from ertis_driver.ertis_device import ErtisDevice, open_serial
from ertis_driver.firmware import FirmwareState
from ertis_driver.links import SerialLink

SHORT = Settings(num_words=32_768)
NUM_BYTES = 4 * 32_768 + 12


@pytest.fixture
def babbler(bare_pty):
    """Writes to the pty without end once it is told to."""
    stop, begin = threading.Event(), threading.Event()

    def babble():
        begin.wait()
        os.set_blocking(bare_pty.master, False)
        while not stop.is_set():
            try:
                os.write(bare_pty.master, b"\x55" * 4096)
            except BlockingIOError:
                time.sleep(0.001)

    thread = threading.Thread(target=babble)
    thread.start()
    yield begin
    begin.set()
    stop.set()
    thread.join()


def test_what_babbles_when_opened_is_given_up(bare_pty, babbler):
    babbler.set()
    with pytest.raises(DeviceBabbles, match="goes on: stop its external trigger or replug it"):
        open_serial(bare_pty.path, frame_timeout_s=0.3)


def test_what_begins_to_babble_ends_ping_and_configure_with_an_error(faulty, babbler):
    def change(reply):
        if len(reply) > 4:
            babbler.set()
            return b""
        return reply

    with open_serial(faulty(change), timeout_s=0.3, frame_timeout_s=0.3) as device:
        device.configure(SHORT)
        with pytest.raises(FrameCorrupt, match="ping again"):
            device.ping()
        with pytest.raises(DeviceBabbles):
            device.ping()
        with pytest.raises(DeviceBabbles):
            device.configure(SHORT)
        assert device.settings is None
        assert device.bytes_lost > 10_000


@pytest.mark.parametrize("letter", ["G", "F", "D", "E", "L", "I"])
def test_a_device_that_leaves_a_command_unanswered_names_it(faulty, source, letter):
    class HalfSilent(FirmwareState):
        def _take(self, line):
            reply = super()._take(line)
            return None if line.startswith(b"!" + letter.encode()) else reply

    with open_serial(faulty(lambda reply: reply, HalfSilent(source)), timeout_s=0.2) as device:
        with pytest.raises(DeviceTimeout, match=f"!{letter},.* 0 of 4 bytes in 0.2 s: configure"):
            device.configure(SHORT)
        with pytest.raises(NotConfigured, match="configure it first"):
            device.ping()


def test_a_device_that_answers_with_a_byte_too_many_is_found_out(faulty):
    count = []

    def change(reply):
        count.append(reply)
        return reply + b"\0" if len(count) == 500 else reply  # in the upload

    with open_serial(faulty(change), timeout_s=0.3) as device:
        with pytest.raises(DeviceError):
            device.configure(SHORT)
        assert device.settings is None
        device.configure(SHORT)
        assert device.ping().ping_index == 0


def test_a_slow_device_is_waited_for(faulty):
    def change(reply):
        for byte in reply[:3]:
            time.sleep(0.02)
            os.write(change.master, bytes([byte]))
        time.sleep(0.02)
        return reply[3:]

    def fast_after_identify(reply):
        count.append(reply)
        return change(reply) if len(count) < 4 else reply

    count = []
    path = faulty(fast_after_identify)
    change.master = faulty.master
    with open_serial(path) as device:
        device.configure(SHORT)
        assert device.ping().ping_index == 0


def test_a_late_frame_is_never_the_answer_to_the_next_ping(source):
    """A frame that was asked for and given up comes when the next one is asked for."""
    make = source.next_frame

    def slow(request):
        words = make(request)
        time.sleep(0.5 if request.index in (0, 2) else 0.0)
        return words

    source.next_frame = slow
    late = 0
    with Emulator(source) as emulator:
        device = open_serial(emulator.path, timeout_s=0.2, frame_timeout_s=0.2)
        device.configure(SHORT)
        for _ in range(6):
            before_ns = time.time_ns()
            try:
                frame = device.ping()
            except DeviceTimeout:
                late += 1
                continue
            asked = source.requests[-1]
            assert frame.ping_index == asked.index
            assert before_ns <= frame.ping_time_ns
            np.testing.assert_array_equal(
                frame.words, source.words(asked.index, 32_768, active=True)
            )
        device.close()
    assert late >= 2
    assert len(source.requests) >= 4


def test_a_frame_that_comes_twice_is_delivered_once(faulty, source):
    def change(reply):
        return reply if len(reply) == 4 else reply + reply

    with open_serial(faulty(change)) as device:
        device.configure(SHORT)
        for index in range(4):
            frame = device.ping()
            assert frame.ping_index == index
            np.testing.assert_array_equal(frame.words, source.words(index, 32_768, active=True))
        assert device.bytes_lost >= 2 * NUM_BYTES


@pytest.mark.parametrize("damage", ["lose", "double", "insert", "header", "footer", "trail"])
def test_damage_on_the_wire_costs_one_ping_and_is_counted(faulty, source, damage):
    damaged = []

    def change(reply):
        if len(reply) == 4 or damaged:
            return reply
        damaged.append(reply)
        return {
            "lose": reply[:70_000] + reply[70_100:],
            "double": reply[:70_100] + reply[70_000:],
            "insert": reply[:70_000] + b"\xaa" * 37 + reply[70_000:],
            "header": b"\0" + reply[1:],
            "footer": reply[:-1] + b"\0",
            "trail": reply + b"\xaa" * 37,
        }[damage]

    with open_serial(faulty(change), timeout_s=0.3) as device:
        device.configure(SHORT)
        if damage == "trail":
            assert device.ping().ping_index == 0
        else:
            with pytest.raises(FrameCorrupt, match="ping again"):
                device.ping()
        frame = device.ping()
        assert frame.ping_index == 1
        np.testing.assert_array_equal(frame.words, source.words(1, 32_768, active=True))
        assert device.bytes_lost == {
            "lose": NUM_BYTES - 100,
            "double": NUM_BYTES + 100,
            "insert": NUM_BYTES + 37,
            "trail": 37,
        }.get(damage, NUM_BYTES)
        assert device.restarts == 0


def test_a_line_that_a_dead_process_left_half_written_is_got_over(emulator):
    fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
    os.write(fd, b"!C,12,20")
    os.close(fd)
    with open_serial(emulator.path, timeout_s=0.4) as device:
        device.configure(SHORT)
        assert device.ping().ping_index == 0


def test_a_reply_left_on_the_link_does_not_become_part_of_a_frame(faulty, source):
    def change(reply):
        return reply if len(reply) == 4 else reply + protocol.encode_reply(protocol.HEADER)

    with open_serial(faulty(change)) as device:
        device.configure(SHORT)
        for index in range(3):
            np.testing.assert_array_equal(
                device.ping().words, source.words(index, 32_768, active=True)
            )


def test_a_step_of_the_host_clock_is_flagged_once(emulator):
    set_by_ns = [0]

    def read():
        unix_ns, boot_ns = read_clocks()
        return unix_ns + set_by_ns[0], boot_ns

    link = SerialLink(emulator.path)
    with ErtisDevice(link, "serial:", clock=HostClock(read)) as device:
        device.configure(SHORT)
        steps = []
        for set_by_ns[0] in (0, 0, -3_600_000_000_000, -3_600_000_000_000, 5_000_000_000):
            frame = device.ping()
            assert abs(frame.ping_time_ns - set_by_ns[0] - time.time_ns()) < 1e9
            steps.append(round(frame.clock_step_ns / 1e9, 2))
    assert steps == [0, 0, -3600, 0, 3605]
