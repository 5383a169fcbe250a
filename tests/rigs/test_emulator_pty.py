import os
import time

import numpy as np
import pytest

from ertis_driver import protocol
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.emulator import Emulator
from ertis_driver.errors import (
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    DevicePermission,
    DeviceTimeout,
    FrameCorrupt,
    NotConfigured,
    RecordingError,
    WrongDevice,
)
from ertis_driver.ertis_device import open_serial
from ertis_driver.firmware import FirmwareState
from ertis_driver.open import open_device

SHORT = Settings(num_words=32_768)


def test_pings_arrive_bit_for_bit(emulator, source):
    with open_device(f"serial:{emulator.path}") as device:
        assert device.info.address == f"serial:{emulator.path}"
        assert (device.info.source, device.info.firmware) == ("sim", "2.3.4")
        assert not device.is_live
        with pytest.raises(NotConfigured):
            device.ping()
        device.configure(Settings())
        for index, active in enumerate([True, False, True]):
            before = time.time_ns()
            frame = device.ping(active=active)
            assert frame.ping_index == index
            assert frame.active is active
            assert before <= frame.ping_time_ns <= time.time_ns()
            assert 0 <= frame.time_uncertainty_ns < 1_000_000_000
            np.testing.assert_array_equal(frame.words, source.words(index, 163_840, active=active))
        assert device.pings_lost == 0
        assert len(device.exchanges) == 20
        assert device.exchanges[-1].sent == "!A,1,0,0"
    assert [request.active for request in source.requests] == [True, False, True]


def test_the_source_is_given_the_chirp_as_uploaded(emulator, source):
    with open_serial(emulator.path) as device:
        for chirp in (DEFAULT_CHIRP, INCUMBENT_CHIRP):
            device.configure(Settings(chirp, 32_768))
            device.ping()
            request = source.requests[-1]
            np.testing.assert_array_equal(request.dac_codes, chirp.dac_codes())
            assert (request.num_words, request.dac_rate_hz) == (32_768, 450_000)


def test_the_link_replaces_a_link_and_is_removed_but_a_file_in_its_place_is_not(source, tmp_path):
    link = tmp_path / "port"
    link.symlink_to("nowhere")
    with Emulator(source, link=link) as emulator:
        assert str(link.readlink()) == emulator.path
    assert not link.is_symlink()
    with Emulator(source, link=link):
        link.unlink()
        link.write_text("mine")
    assert link.read_text() == "mine"


def test_a_client_may_come_and_go(emulator, source):
    for index in range(3):
        with open_serial(emulator.path) as device:
            device.configure(SHORT)
            assert device.ping().ping_index == index
        device.close()


def test_a_client_that_left_in_mid_frame_spoils_nothing_for_the_next(emulator, source):
    fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
    os.write(fd, b"!A,1,0,0\n")
    os.read(fd, 1000)
    os.close(fd)
    with open_serial(emulator.path) as device:
        device.configure(SHORT)
        frame = device.ping()
        np.testing.assert_array_equal(frame.words, source.words(1, 32_768, active=True))


def test_a_marked_replay_is_not_live_and_unmarked_firmware_is(source):
    for mark in ("replay", "live"):
        with Emulator(source, mark=mark) as emulator, open_serial(emulator.path) as device:
            assert device.info.source == mark
            assert device.is_live is (mark == "live")


def test_a_port_that_never_answers_is_given_up_soon(bare_pty):
    path = bare_pty.path
    start = time.monotonic()
    with pytest.raises(DeviceTimeout, match=f"no answer in 1 s at {path}: not an eRTIS"):
        open_serial(path)
    assert time.monotonic() - start < 4.0, "a reply is not waited for like a frame, 5 s"


def test_something_else_that_answers_is_the_wrong_device(faulty):
    path = faulty(lambda reply: b"ERROR\r\n")
    with pytest.raises(WrongDevice, match="name another port"):
        open_serial(path)


def test_a_missing_port_is_not_found(tmp_path):
    with pytest.raises(DeviceNotFound, match="check cable"):
        open_serial(str(tmp_path / "ttyACM0"))


@pytest.mark.parametrize("port", ["file", ".", "/dev/null"])
def test_what_is_no_port_is_the_wrong_device(tmp_path, port):
    (tmp_path / "file").write_bytes(b"hello")
    with pytest.raises(WrongDevice, match="not a serial port"):
        open_serial(str(tmp_path / port))


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_a_port_without_permission_names_rule_and_group(tmp_path):
    (tmp_path / "port").touch(mode=0)
    with pytest.raises(DevicePermission, match="group dialout"):
        open_serial(str(tmp_path / "port"))


def test_a_port_in_use_is_busy(emulator):
    with open_serial(emulator.path), pytest.raises(DeviceBusy, match="in use"):
        open_serial(emulator.path)


def test_a_device_that_goes_away_in_mid_frame_is_lost(faulty, bare_pty):
    def change(reply):
        if len(reply) == 4:
            return reply
        half = reply[:3000]
        while half:
            half = half[os.write(bare_pty.master, half) :]
        time.sleep(0.1)
        bare_pty.hang_up()
        return None

    with open_serial(faulty(change)) as device:
        device.configure(SHORT)
        with pytest.raises(DeviceLost, match="reopen"):
            device.ping()
        with pytest.raises(DeviceLost, match="reopen"):
            device.ping()


def test_half_a_frame_is_corrupt_and_the_next_ping_is_whole_again(faulty, source):
    sent = []

    def change(reply):
        if len(reply) == 4:
            return reply
        sent.append(reply)
        return reply[:50_000] if len(sent) == 1 else reply

    with open_serial(faulty(change), timeout_s=0.3, frame_timeout_s=30.0) as device:
        device.configure(SHORT)
        start = time.monotonic()
        with pytest.raises(FrameCorrupt, match="50000 of 131084 bytes"):
            device.ping()
        assert time.monotonic() - start < 15.0, "silence in mid-frame need not wait for 30 s"
        frame = device.ping()
        np.testing.assert_array_equal(frame.words, source.words(1, 32_768, active=True))


def test_a_frame_with_a_wrong_footer_is_corrupt(faulty):
    with open_serial(
        faulty(lambda reply: reply if len(reply) == 4 else reply[:-1] + b"\0"), timeout_s=0.3
    ) as device:
        device.configure(SHORT)
        with pytest.raises(FrameCorrupt, match="header or footer wrong"):
            device.ping()


def test_a_silent_ping_times_out(source):
    def refuse(request):
        raise RecordingError("nothing to play")

    source.next_frame = refuse
    with (
        Emulator(source) as emulator,
        open_serial(emulator.path, frame_timeout_s=0.2) as device,
    ):
        device.configure(SHORT)
        with pytest.raises(DeviceTimeout, match="no frame"):
            device.ping()


def test_a_failed_configure_leaves_it_unconfigured(faulty):
    count = []

    def change(reply):
        count.append(reply)
        # Past the first configure (about 1140 replies), in the middle of the second upload.
        return b"" if len(count) > 1700 else reply

    with open_serial(faulty(change), timeout_s=0.2) as device:
        device.configure(SHORT)
        assert device.settings == SHORT
        with pytest.raises(DeviceTimeout, match="!C,"):
            device.configure(Settings(INCUMBENT_CHIRP, 32_768))
        assert device.settings is None
        with pytest.raises(NotConfigured):
            device.ping()


class WholeBufferHash(FirmwareState):
    """L over the whole buffer, as real firmware may do."""

    def _set(self, letter, args):
        if letter == "L":
            return protocol.chirp_hash(self._dac_codes)
        return super()._set(letter, args)


class DeafToOneSample(FirmwareState):
    """Loses DAC sample 500."""

    def _set(self, letter, args):
        if letter == "C" and args[0] == 500:
            return args[1]
        return super()._set(letter, args)


def test_a_hash_over_the_whole_buffer_is_understood(faulty, source):
    state = WholeBufferHash(source)
    state._dac_codes[60_000] = 77  # from a longer chirp, before
    with open_serial(faulty(lambda reply: reply, state)) as device:
        device.configure(SHORT)
        device.ping()
    np.testing.assert_array_equal(source.requests[-1].dac_codes, DEFAULT_CHIRP.dac_codes())


def test_a_lost_dac_sample_is_found_by_the_hash(faulty, source):
    with open_serial(faulty(lambda reply: reply, DeafToOneSample(source))) as device:
        with pytest.raises(DeviceError, match="another chirp"):
            device.configure(SHORT)
        assert device.settings is None


def test_lost_pings_are_counted_over_the_wrap(emulator):
    with open_serial(emulator.path) as device:
        device.configure(SHORT)
        for index, lost in [(2**32 - 10, 0), (2**32 - 7, 2), (2**32 - 1, 7), (0, 7), (1001, 1007)]:
            emulator.state.ping_index = index
            assert device.ping().ping_index == index
            assert device.pings_lost == lost
        assert device.restarts == 0


@pytest.mark.parametrize("index", [0, 16, 2_000_000])
def test_a_counter_that_began_anew_is_a_restart_and_no_billions(emulator, source, index):
    with open_serial(emulator.path) as device:
        device.configure(SHORT)
        emulator.state.ping_index = 17
        device.ping()
        emulator.state._dac_codes[:] = 2048  # as after power on
        emulator.state.ping_index = index
        with pytest.raises(FrameCorrupt, match=f"ping {index} of .* follows ping 17: it restarted"):
            device.ping()
        frame = device.ping()
        assert frame.ping_index == index + 1
        np.testing.assert_array_equal(source.requests[-1].dac_codes, DEFAULT_CHIRP.dac_codes())
        assert (device.pings_lost, device.restarts) == (0, 1)


def test_a_command_after_an_unread_frame_drops_the_rest_of_it(emulator):
    fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(fd, b"!A,1,0,0\n")
        met = len(os.read(fd, 100))
        time.sleep(0.2)  # the pty is full now, and the emulator waits
        os.write(fd, b"!Y,0,0,0\n")
        data = b""
        while not data.endswith(protocol.encode_reply(emulator.state._version)):
            data = data[-3:] + os.read(fd, 4096)
            met += 4096
        assert met < 655_372
    finally:
        os.close(fd)


def test_an_emulator_nobody_reads_stops_at_once(source):
    fd = None
    try:
        with Emulator(source) as emulator:
            fd = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
            os.write(fd, b"!A,1,0,0\n")
            os.read(fd, 100)
            start = time.monotonic()
        assert time.monotonic() - start < 10.0
    finally:
        if fd is not None:
            os.close(fd)


def test_an_idle_emulator_does_not_spin(emulator):
    with open_serial(emulator.path) as device:
        device.configure(SHORT)
    start = time.process_time()
    time.sleep(0.5)
    assert time.process_time() - start < 0.2


def test_garbage_lines_are_ignored_and_both_forms_of_j_are_taken(source):
    state = FirmwareState(source)
    assert state.feed(b"hello\n!Q,1,2,3\n!C,1\n!G,7,0,0,0,0,0,0\n\n" + b"x" * 1000 + b"\n") == []
    assert state.garbage_lines == 6
    (version,) = state.feed(b"noise!Y,0,0,0\n")
    assert protocol.parse_firmware(protocol.decode_reply(version)) == "2.3.4"
    assert len(state.feed(b"!J,1,2,0,0\n!J,1,2,0\n")) == 2
    assert state.feed(b"!B,7") == []
    assert [protocol.decode_reply(reply) for reply in state.feed(b",0,0\n")] == [7]
    assert state.ping_index == 7


@pytest.mark.parametrize("command", [b"!G,5,0,0", b"!G,131076,0,0", b"!C,65535,1,0", b"!D,1,0,0"])
def test_firmware_holds_on_to_what_it_has_when_asked_for_the_impossible(source, command):
    state = FirmwareState(source)
    (reply,) = state.feed(command + b"\n")
    assert len(reply) == 4
    assert protocol.decode_frame(state.feed(b"!A,1,0,0\n")[0]).words.size == 163_840


def test_fifty_default_frames_in_a_row_are_all_whole(emulator, source):
    with open_serial(emulator.path) as device:
        device.configure(Settings())
        for index in range(50):
            assert device.ping().ping_index == index
        assert device.pings_lost == 0
