import os
import select
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fault_campaign import draw_case, name_of, run_campaign, table

from ertis_driver import protocol
from ertis_driver.chirp import Chirp
from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.emulator import MAX_EDGES, POLL_S, Emulator
from ertis_driver.errors import DeviceError, DeviceLost, DeviceTimeout, FrameCorrupt
from ertis_driver.ertis_device import open_serial
from ertis_driver.fault_plan import DrawnFaults, NamedFaults, parse_fault

DEADLINE_S = 10
SHORT = Settings(Chirp(duration_s=0.00015), 32_768)
FRAME_BYTES = protocol.frame_bytes(32_768)
SEED = 3


def emulator_with(source, *texts, **options):
    return Emulator(source, faults=NamedFaults(map(parse_fault, texts)), **options)


def open_short(path):
    # A pty on a busy machine may take half a second for a frame.
    device = open_serial(str(path), timeout_s=1.0, frame_timeout_s=2.0)
    device.configure(SHORT)
    return device


def good_ping(device, source):
    """A ping whose frame is one that was made for it."""
    frame = device.ping()
    made = source.words(frame.ping_index, 32_768, active=True)
    np.testing.assert_array_equal(frame.words, made)
    assert source.requests[-1].index == frame.ping_index, "the frame of an earlier ping"
    return frame


def read_bytes(fd, count):
    data = b""
    while len(data) < count and select.select([fd], [], [], DEADLINE_S)[0]:
        data += os.read(fd, count - len(data))
    return data


@pytest.fixture
def port(emulator):
    fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
    yield fd
    os.close(fd)


@pytest.mark.parametrize("num_faults", [1500, pytest.param(10_000, marks=pytest.mark.slow)])
def test_thousands_of_faults_give_no_wrong_frame_no_uncounted_loss_and_no_hang(num_faults):
    rows, failures = run_campaign(SEED, num_faults)
    print(table(rows))
    assert failures == []
    assert sum(row.injected for row in rows.values()) == num_faults


def test_a_case_of_the_campaign_is_the_same_each_time_and_all_kinds_come():
    cases = [draw_case(SEED, number) for number in range(3000)]
    assert cases == [draw_case(SEED, number) for number in range(3000)]
    assert len({name_of(fault, unit) for fault, unit, _ in cases}) >= 23


def test_a_late_frame_of_an_earlier_ping_does_not_pass_for_the_next_ones(source):
    for past_replies in (0, 1):
        with (
            emulator_with(source, f"late@frame=1,past_replies={past_replies}") as emulator,
            open_short(emulator.path) as device,
        ):
            good_ping(device, source)
            with pytest.raises(DeviceTimeout):
                device.ping()
            assert good_ping(device, source).ping_index == 2
            assert device.pings_lost == 1


def test_a_first_frame_that_is_late_does_not_pass_for_the_second(source):
    with (
        emulator_with(source, "late@frame=0,past_replies=1") as emulator,
        open_short(emulator.path) as device,
    ):
        with pytest.raises(DeviceTimeout):
            device.ping()
        assert good_ping(device, source).ping_index == 1


class LookAlike:
    """A header in the payload of frame 1, and a footer as far behind it when frame 1 is cut."""

    def __init__(self, source, cut):
        self.requests = source.requests
        self._source, self._cut = source, cut

    def next_frame(self, request):
        words = self._source.next_frame(request)
        if request.index == 1:
            words[1000] = protocol.HEADER
        if request.index == 2:
            words[(4008 + FRAME_BYTES - 4 - self._cut) // 4 - 2] = protocol.FOOTER
        return words


def test_payload_that_looks_like_a_frame_between_two_cut_ones_is_not_delivered(source):
    cut = 52_000
    plan = NamedFaults([parse_fault(f"truncate@frame=1,byte={cut}")])
    with (
        Emulator(LookAlike(source, cut), faults=plan) as emulator,
        open_short(emulator.path) as device,
    ):
        good_ping(device, source)
        try:
            index = device.ping().ping_index
        except FrameCorrupt:
            index = None
        assert index in (None, 2)
        assert good_ping(device, source).ping_index == 3


def test_an_unasked_frame_behind_a_damaged_one_has_its_own_time(source):
    edges_ns = []

    def edge():
        edges_ns.append(time.time_ns())
        emulator.trigger(1)

    with (
        emulator_with(source, "drop@frame=1,byte=1000,count=7") as emulator,
        open_serial(emulator.path) as device,
    ):
        device.configure(replace(SHORT, external_trigger=ExternalTrigger(pin=1)))
        edge()
        device.wait_frame(DEADLINE_S)
        edge()
        later = threading.Timer(0.2, edge)  # while the client waits for the rest of frame 1
        later.start()
        frame = device.wait_frame(DEADLINE_S)
        later.join()
        assert frame.ping_index == 2
        # The emulator answers an edge at once, without the 7.3 ms of listening.
        assert frame.ping_time_ns + frame.time_uncertainty_ns >= edges_ns[-1] - 8_300_000


def test_a_device_unplugged_in_mid_frame_comes_back_under_its_link(source, tmp_path):
    link = tmp_path / "ertis"
    plugged = []
    with emulator_with(
        source, "vanish@frame=1,byte=5000,away=0.1", link=link, on_plug=plugged.append
    ) as emulator:
        with open_short(link) as device:
            good_ping(device, source)
            with pytest.raises(DeviceLost):
                device.ping()
        end = time.monotonic() + DEADLINE_S
        while not link.exists():
            assert time.monotonic() < end, "not back"
            time.sleep(0.01)
        assert plugged == [emulator.path]
        with open_short(link) as device:
            assert good_ping(device, source).ping_index == 0, "what has no power forgets"
    assert not link.is_symlink()


def test_a_device_unplugged_for_ever_takes_its_link_along_and_ends_the_emulator(source, tmp_path):
    link = tmp_path / "ertis"
    with emulator_with(source, "vanish@frame=0,byte=9", link=link) as emulator:
        with open_short(emulator.path) as device, pytest.raises(DeviceLost):
            device.ping()
        assert not link.is_symlink(), "the path may be another device's by now"
        emulator._thread.join(DEADLINE_S)
        assert not emulator._thread.is_alive()


def test_a_reset_device_that_lost_its_settings_pings_again_once_configured(source):
    with (
        emulator_with(source, "reset@frame=2,byte=7000") as emulator,
        open_short(emulator.path) as device,
    ):
        assert [good_ping(device, source).ping_index for _ in range(2)] == [0, 1]
        for _ in range(2):
            with pytest.raises(DeviceError):
                device.ping()
        device.configure(SHORT)
        for attempt in range(3):  # one may show the reset, one may have the index of the last
            try:
                index = good_ping(device, source).ping_index
                break
            except DeviceError:
                assert attempt < 2
        assert index < 5
        assert device.pings_lost < 5, "a restart is no loss of billions"


def test_drawn_faults_are_those_that_the_named_ones_repeat(source):
    def run(plan):
        outcomes = []
        with Emulator(source, faults=plan) as emulator, open_short(emulator.path) as device:
            for _ in range(12):
                try:
                    outcomes.append(good_ping(device, source).ping_index)
                except DeviceError as error:
                    outcomes.append(type(error).__name__)
            return outcomes, [str(planned) for planned in emulator.injector.injected]

    kinds = ("drop", "double", "magic", "jump")
    drawn, texts = run(DrawnFaults(42, 0.4, kinds))
    named, again = run(NamedFaults(map(parse_fault, texts)))
    assert texts == again
    assert len(texts) >= 2
    assert drawn == named


def test_edges_on_the_enabled_pin_give_frames_unasked_and_at_once(emulator, source, port):
    os.write(port, b"!G,131072,0,0\n!J,1,2,0\n!H,1,0,0\n")
    assert len(read_bytes(port, 12)) == 12
    emulator.trigger(1)  # not enabled: nothing comes of it
    waited_s = []
    for index in range(100):
        started_s = time.monotonic()
        emulator.trigger(2)
        select.select([port], [], [], DEADLINE_S)
        waited_s.append(time.monotonic() - started_s)
        frame = protocol.decode_frame(read_bytes(port, FRAME_BYTES))
        assert frame.index == index
        np.testing.assert_array_equal(frame.words, source.words(index, 32_768, active=True))
    # Busy machines are slow, but one that is not woken is never faster than its next look.
    assert min(waited_s) < POLL_S / 2


def test_edges_that_nobody_reads_the_frames_of_are_dropped_not_hoarded(emulator, source, port):
    os.write(port, b"!G,131072,0,0\n!J,1,1,0\n")
    read_bytes(port, 8)
    for _ in range(10 * MAX_EDGES):
        emulator.trigger(1)
        if len(source.requests) >= 8:
            time.sleep(0.001)
    assert len(source.requests) <= 10


def test_an_emulator_that_babbles_or_stalls_stops_at_once(source):
    for text in ("babble@frame=0,byte=100", "stall@frame=0,byte=100,seconds=60"):
        with emulator_with(source, text) as emulator:
            fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
            os.write(fd, b"!A,1,0,0\n")
            read_bytes(fd, 100)
            started_s = time.monotonic()
        os.close(fd)
        assert time.monotonic() - started_s < DEADLINE_S


@pytest.fixture
def emulate(tmp_path):
    """Starts the command on a recording of one ping; gives process and first line."""
    recording = tmp_path / "r.bin"
    recording.write_bytes(np.random.default_rng(1).bytes(4 * 32_768))
    processes = []

    def start(*arguments):
        command = [sys.executable, "-m", "ertis_daemon.cli", "emulate", "--replay", str(recording)]
        process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        processes.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_the_command_makes_the_faults_that_were_asked_for(emulate, tmp_path):
    link = tmp_path / "sonar"
    process, path = emulate(
        *("--fault", "magic@frame=1", "--fault", "vanish@frame=3,byte=9,away=0.2"),
        *("--link", str(link)),
    )
    assert link.readlink() == Path(path)
    with open_short(path) as device:
        assert device.ping().ping_index == 0
        with pytest.raises(FrameCorrupt):
            device.ping()
        assert device.ping().ping_index == 2
        with pytest.raises(DeviceLost):
            device.ping()
    back = process.stdout.readline().strip()
    assert link.readlink() == Path(back)
    with open_short(link) as device:
        assert device.ping().ping_index == 0
    process.terminate()
    assert process.wait(DEADLINE_S) == 0
    assert not link.is_symlink()


def test_the_command_ends_when_its_device_is_unplugged_for_ever(emulate):
    process, path = emulate("--fault", "vanish@frame=0,byte=9")
    with open_short(path) as device, pytest.raises(DeviceLost):
        device.ping()
    assert process.wait(DEADLINE_S) == 0


def test_a_signal_to_the_command_is_an_edge_on_its_pin(emulate):
    process, path = emulate("--trigger-form", "windows", "--no-amplifier")
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(fd, b"!G,131072,0,0\n!K,1,0,0\n!J,1,2,0\n")
        replies = read_bytes(fd, 12)
        assert protocol.decode_reply(replies[4:8]) == 0, "no amplifier"
        assert protocol.decode_reply(replies[8:]) != 0
        process.send_signal(signal.SIGUSR1)  # pin 1 is not enabled
        for index in range(2):
            process.send_signal(signal.SIGUSR2)
            assert protocol.decode_frame(read_bytes(fd, FRAME_BYTES)).index == index
    finally:
        os.close(fd)


def test_a_board_without_trigger_says_so(emulate):
    _, path = emulate("--no-trigger")
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(fd, b"!J,1,2,0\n")
        assert protocol.decode_reply(read_bytes(fd, 4)) == 0
    finally:
        os.close(fd)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["--fault", "dorp@frame=1"], 2, "expected drop?"),
        (["--fault", "drop@frame=1,cuont=3"], 2, "expected count?"),
        (["--fault-seed", "1"], 1, "--fault-rate"),
        (["--fault-rate", "2"], 1, "0 to 1"),
        (["--fault-rate", "0.5", "--fault", "drop@frame=1"], 1, "exclude each other"),
    ],
)
def test_a_fault_that_cannot_be_ends_the_command(emulate, arguments, code, says):
    process, _ = emulate(*arguments)
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert (process.returncode, says in errors) == (code, True), errors
