"""A sonar unplugged and replugged: the firmware emulator's pty goes away, and comes back as another
one under the same symlink, as udev makes it."""

import logging
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.emulator import Emulator
from ertis_driver.errors import DeviceLost, DeviceNotFound, NotConfigured, PingLost
from ertis_driver.open import open_device
from ertis_driver.reconnect import ReconnectingSonar

SHORT = Settings(num_words=32_768)
OPTIONS = {"timeout_s": 0.5, "frame_timeout_s": 0.5}


class Ramp:
    """Frames that tell their index."""

    def next_frame(self, request):
        return np.arange(request.num_words, dtype=np.uint32) + np.uint32(request.index)


def ping_until_it_fails(sonar):
    for _ in range(3):
        sonar.ping()


class Cable:
    """The symlink to whatever emulator is plugged in."""

    def __init__(self, link):
        self.link = link
        self.emulator = None
        self.lock = threading.Lock()  # a test may pull it from a thread, and end meanwhile

    def plug(self, source=None):
        self.emulator = Emulator(source or Ramp())
        self.emulator.start()
        new = self.link.with_suffix(".new")
        new.symlink_to(self.emulator.path)
        new.rename(self.link)

    def unplug(self):
        with self.lock:
            if self.emulator is not None:
                self.link.unlink()
                self.emulator.close()
                self.emulator = None


@pytest.fixture
def cable(tmp_path):
    cable = Cable(tmp_path / "ertis-ERTIS001")
    cable.plug()
    yield cable
    cable.unplug()


@pytest.fixture
def sonar(cable):
    with ReconnectingSonar(f"serial:{cable.link}", SHORT, **OPTIONS) as sonar:
        yield sonar


def test_it_pings_as_the_device_itself_does(cable, sonar):
    assert sonar.info.address == f"serial:{cable.link}"
    assert not sonar.is_live
    assert sonar.settings == SHORT
    assert [sonar.ping().ping_index for _ in range(3)] == [0, 1, 2]
    assert sonar.reconnects == 0


def test_after_a_replug_the_next_ping_works_with_the_same_settings(cable, sonar, caplog):
    caplog.set_level(logging.INFO, "ertis_driver.reconnect")
    sonar.ping()
    cable.unplug()
    with pytest.raises(PingLost, match="ping again"):
        sonar.ping()
    assert not sonar.is_connected
    cable.plug()
    frame = sonar.ping()
    assert (frame.ping_index, len(frame.words)) == (0, 32_768)
    assert frame.words[7] == 7
    assert sonar.settings == SHORT
    assert sonar.reconnects == 1
    assert sonar.is_connected
    said = [its.getMessage() for its in caplog.records if its.levelno >= logging.WARNING]
    assert len(said) == 2, "lost, and back"
    assert "went away" in said[0]
    assert "is back after" in said[1]


def test_as_long_as_it_is_away_each_ping_ends_soon_and_says_so(cable, sonar):
    cable.unplug()
    for _ in range(3):
        with pytest.raises(PingLost):
            sonar.ping()
    cable.plug()
    sonar.ping()
    assert sonar.reconnects == 1


def test_a_ping_waits_for_a_device_that_comes_back_meanwhile(cable):
    with ReconnectingSonar(f"serial:{cable.link}", SHORT, patience_s=20, **OPTIONS) as sonar:
        cable.unplug()
        with pytest.raises(PingLost):
            sonar.ping()
        timer = threading.Timer(0.5, cable.plug)
        timer.start()
        sonar.ping()
        timer.join()
        assert sonar.reconnects == 1


def test_it_survives_any_number_of_replugs_and_leaves_no_descriptor_behind(cable, sonar):
    def descriptors():
        return len(list(Path("/proc/self/fd").iterdir()))

    before = descriptors()
    for count in range(1, 6):
        cable.unplug()
        with pytest.raises(PingLost):
            sonar.ping()
        cable.plug()
        sonar.ping()
        assert sonar.reconnects == count
        assert descriptors() == before


def test_a_device_lost_in_mid_frame_gives_no_frame(cable):
    class Unplugged:
        def next_frame(self, request):
            if request.index == 1:
                threading.Thread(target=cable.unplug).start()
            return Ramp().next_frame(request)

    cable.unplug()
    cable.plug(Unplugged())
    with ReconnectingSonar(f"serial:{cable.link}", SHORT, **OPTIONS) as sonar:
        sonar.ping()
        with pytest.raises(PingLost):
            ping_until_it_fails(sonar)


def test_another_ping_size_set_while_it_is_away_is_sent_when_it_is_back(cable, sonar):
    cable.unplug()
    with pytest.raises(PingLost):
        sonar.ping()
    with pytest.raises(PingLost):
        sonar.configure(Settings(num_words=65_536))
    cable.plug()
    assert len(sonar.ping().words) == 65_536


def test_the_external_trigger_is_set_again_after_a_replug(cable):
    edges = replace(SHORT, external_trigger=ExternalTrigger(2))
    with ReconnectingSonar(f"serial:{cable.link}", edges, **OPTIONS) as sonar:
        cable.emulator.trigger(2)
        assert sonar.wait_frame(5.0).ping_index == 0
        cable.unplug()
        with pytest.raises(PingLost):
            sonar.wait_frame(5.0)
        cable.plug()
        heard = threading.Event()

        def edges():  # until one comes after the trigger was set
            while not heard.wait(0.2):
                cable.emulator.trigger(2)

        edging = threading.Thread(target=edges)
        edging.start()
        try:
            assert sonar.wait_frame(5.0).words[5] == 5
        finally:
            heard.set()
            edging.join()
        assert sonar.reconnects == 1


@pytest.mark.parametrize("away", [True, False])
def test_closing_in_another_thread_ends_the_ping_at_once(cable, away):
    cable.unplug()
    release = threading.Event()

    class Slow:
        def next_frame(self, request):
            release.wait(30)
            return Ramp().next_frame(request)

    cable.plug(Slow())
    sonar = ReconnectingSonar(f"serial:{cable.link}", SHORT, patience_s=60, frame_timeout_s=30)
    if away:
        release.set()
        cable.unplug()
        with pytest.raises(PingLost):
            sonar.ping()
    met = []

    def ping():
        try:
            sonar.ping()
        except DeviceLost as error:
            met.append(str(error))

    thread = threading.Thread(target=ping)
    thread.start()
    time.sleep(0.3)
    sonar.close()
    thread.join(10)
    release.set()
    assert not thread.is_alive()
    assert "closed" in met[0]
    with pytest.raises(DeviceLost, match="closed"):
        sonar.ping()
    sonar.close()


def test_what_is_not_there_at_first_is_not_found(tmp_path):
    with pytest.raises(DeviceNotFound):
        ReconnectingSonar(f"serial:{tmp_path / 'none'}")


def test_it_is_configured_before_it_pings(cable):
    with ReconnectingSonar(f"serial:{cable.link}", **OPTIONS) as sonar:
        with pytest.raises(NotConfigured):
            sonar.ping()
        sonar.configure(SHORT)
        sonar.ping()


def test_open_device_makes_one_on_request_for_hardware_only(cable, tmp_path):
    with open_device(f"serial:{cable.link}", reconnect=True, **OPTIONS) as sonar:
        assert isinstance(sonar, ReconnectingSonar)
    path = tmp_path / "ping.bin"
    path.write_bytes(bytes(4 * 32_768))
    with open_device(f"replay:{path}", reconnect=True) as sonar:
        assert not isinstance(sonar, ReconnectingSonar)
