"""Frames that an external trigger makes the device send unasked."""

import dataclasses
import os
import threading
import time

import numpy as np
import pytest

from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.errors import DeviceTimeout, FrameCorrupt, NotConfigured
from ertis_driver.ertis_device import open_serial
from ertis_driver.frame import PDM_RATE_HZ
from ertis_driver.protocol import encode_frame

SHORT = Settings(num_words=32_768)
PIN_2 = dataclasses.replace(SHORT, external_trigger=ExternalTrigger(2, active=False))
LISTENING_NS = 32_768 / PDM_RATE_HZ * 1e9


@pytest.mark.parametrize(("pin", "active"), [(1, True), (2, False)])
def test_an_edge_on_the_pin_brings_a_frame(emulator, source, pin, active):
    trigger = ExternalTrigger(pin, active)
    with open_serial(emulator.path) as device:
        device.configure(dataclasses.replace(SHORT, external_trigger=trigger))
        for index in range(3):
            emulator.trigger(3 - pin)
            emulator.trigger(pin)
            frame = device.wait_frame(5.0)
            assert (frame.ping_index, frame.active) == (index, active)
            expected = source.words(index, 32_768, active=active)
            np.testing.assert_array_equal(frame.words, expected)


def test_the_time_of_an_edge_is_within_its_uncertainty(emulator):
    with open_serial(emulator.path) as device:
        device.configure(PIN_2)
        for delay_s in (0.0, 0.2):
            before_ns = time.time_ns()
            timer = threading.Timer(delay_s, emulator.trigger, [2])
            timer.start()
            frame = device.wait_frame(5.0)
            timer.join()
            # The emulator sends what would have taken 7 ms to hear: its edge was that much before.
            assert frame.ping_time_ns + frame.time_uncertainty_ns >= before_ns - LISTENING_NS
            assert frame.ping_time_ns - frame.time_uncertainty_ns <= time.time_ns()
            # At least half of the send latency that nobody has measured.
            assert 2.4e6 < frame.time_uncertainty_ns < 1e9


def test_a_frame_that_waited_says_that_its_time_is_less_certain(emulator):
    with open_serial(emulator.path) as device:
        device.configure(PIN_2)
        before_ns = time.time_ns()
        emulator.trigger(2)
        time.sleep(0.4)
        waited = device.wait_frame(5.0)
        assert waited.time_uncertainty_ns > 150e6
        assert waited.ping_time_ns - waited.time_uncertainty_ns <= before_ns + 60e6
        assert before_ns <= waited.ping_time_ns + waited.time_uncertainty_ns
        threading.Timer(0.2, emulator.trigger, [2]).start()
        fresh = device.wait_frame(5.0)
        assert fresh.time_uncertainty_ns < waited.time_uncertainty_ns


def test_edges_in_a_row_bring_each_frame_once(emulator, source):
    with open_serial(emulator.path) as device:
        device.configure(PIN_2)
        for _ in range(5):
            emulator.trigger(2)
        for index in range(5):
            frame = device.wait_frame(5.0)
            assert frame.ping_index == index
            expected = source.words(index, 32_768, active=False)
            np.testing.assert_array_equal(frame.words, expected)
        assert (device.pings_lost, device.bytes_lost, device.frames_corrupt) == (0, 0, 0)


def test_without_an_edge_it_times_out_and_waits_again(emulator):
    with open_serial(emulator.path) as device:
        device.configure(PIN_2)
        emulator.trigger(1)
        with pytest.raises(DeviceTimeout, match=r"no edge on pin 2 of .* in 0.1 s"):
            device.wait_frame(0.1)
        emulator.trigger(2)
        assert device.wait_frame(5.0).ping_index == 0


def test_ping_and_wait_are_told_apart(emulator):
    with open_serial(emulator.path) as device:
        with pytest.raises(NotConfigured):
            device.wait_frame(0.1)
        device.configure(SHORT)
        with pytest.raises(NotConfigured, match="no external trigger set"):
            device.wait_frame(0.1)
        device.configure(PIN_2)
        with pytest.raises(NotConfigured, match="edges on pin 2: use wait_frame"):
            device.ping()


def test_a_frame_cut_short_costs_itself_and_the_next_is_whole(faulty, source):
    path = faulty(lambda reply: reply)
    frames = [source.words(index, 32_768, active=False) for index in range(3)]

    def send(index, lost):
        data = encode_frame(index, frames[index])
        faulty.send(data[: 50_000 - lost] + data[50_000:])

    def send_all():
        for index, lost in enumerate((8, 0, 0)):
            send(index, lost)

    with open_serial(path, timeout_s=0.3) as device:
        device.configure(PIN_2)
        thread = threading.Thread(target=send_all)
        thread.start()
        found = [device.wait_frame(5.0) for _ in range(2)]
        thread.join()
        assert [frame.ping_index for frame in found] == [1, 2]
        for frame in found:
            np.testing.assert_array_equal(frame.words, frames[frame.ping_index])
        assert device.frames_corrupt == 1
        thread = threading.Thread(target=send, args=(0, 8))
        thread.start()
        with pytest.raises(FrameCorrupt, match="131076 of 131084 bytes"):
            device.wait_frame(5.0)
        thread.join()


def test_settings_can_be_changed_while_edges_come(emulator, source):
    with open_serial(emulator.path) as device:
        device.configure(PIN_2)
        for settings in (dataclasses.replace(PIN_2, num_words=65_536), SHORT, PIN_2):
            emulator.trigger(2)
            emulator.trigger(2)
            device.configure(settings)
        emulator.trigger(2)
        frame = device.wait_frame(5.0)
        expected = source.words(frame.ping_index, 32_768, active=False)
        np.testing.assert_array_equal(frame.words, expected)


def test_whoever_closes_it_switches_the_trigger_off(emulator):
    with open_serial(emulator.path) as device:
        device.configure(dataclasses.replace(PIN_2, amplifier=True))
    deadline = time.monotonic() + 5
    while emulator.state._held["J"] or emulator.state._held["K"]:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_trigger_that_a_dead_process_left_on_does_not_keep_the_next_one_out(emulator):
    fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
    os.write(fd, b"!G,131072,0,0\n!J,1,1,0,0\n")
    met = b""
    while len(met) < 8:  # both are set
        met += os.read(fd, 8 - len(met))
    os.close(fd)
    for _ in range(3):
        emulator.trigger(1)
    with open_serial(emulator.path) as device:
        device.configure(SHORT)
        emulator.trigger(1)
        assert device.ping().ping_index in (3, 4)
