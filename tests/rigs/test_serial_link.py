"""The serial link on a pty: what is left when the cable goes, at any byte."""

import os
import resource
import threading
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ertis_driver.device import Settings
from ertis_driver.emulator import Emulator
from ertis_driver.errors import DeviceLost
from ertis_driver.ertis_device import open_serial
from ertis_driver.links import SerialLink

PATIENCE_S = 10.0


class OpenedLink:
    """A link on a pty of its own; ``device`` is the other end."""

    def __init__(self):
        self.device, slave = os.openpty()
        self.path = os.ttyname(slave)
        self.link = SerialLink(self.path)
        os.close(slave)  # else it would not hang up

    def files(self):
        """How many descriptors of this process lead to the port."""
        count = 0
        for name in os.listdir("/proc/self/fd"):  # noqa: PTH208
            try:
                count += os.readlink(f"/proc/self/fd/{name}").startswith(self.path)  # noqa: PTH115
            except OSError:
                continue
        return count


def read_all(link):
    met = bytearray()
    buffer = memoryview(bytearray(4096))
    while True:
        count = link.read_into(buffer, time.monotonic() + PATIENCE_S)
        assert count, "no byte and no loss"
        met += buffer[:count]
        yield met


@settings(max_examples=60)
@given(data=st.binary(min_size=0, max_size=3000))
def test_a_port_that_hangs_up_after_any_byte_is_lost_and_its_descriptor_closed(data):
    opened = OpenedLink()
    assert opened.files() == 1
    sent = 0
    while sent < len(data):
        sent += os.write(opened.device, data[sent:])
    met = bytearray()
    if data:
        for met in read_all(opened.link):
            if len(met) == len(data):
                break
    assert met == data
    os.close(opened.device)
    with pytest.raises(DeviceLost, match=r"went away.*reopen"):
        opened.link.read_into(memoryview(bytearray(16)), time.monotonic() + PATIENCE_S)
    assert opened.files() == 0
    with pytest.raises(DeviceLost, match="closed"):
        opened.link.write(b"!Y,0,0,0\n", time.monotonic() + PATIENCE_S)
    opened.link.close()


@pytest.mark.parametrize("what", ["read_into", "fill"])
def test_a_port_that_hangs_up_under_a_waiting_read_is_lost(what):
    opened = OpenedLink()
    timer = threading.Timer(0.05, os.close, [opened.device])
    timer.start()
    buffer, end_s = memoryview(bytearray(16)), time.monotonic() + PATIENCE_S
    patience = (end_s,) if what == "read_into" else (end_s, PATIENCE_S, end_s)
    with pytest.raises(DeviceLost, match="went away"):
        getattr(opened.link, what)(buffer, *patience)
    timer.join()
    assert opened.files() == 0


def test_a_write_to_a_port_that_has_hung_up_is_lost():
    opened = OpenedLink()
    os.close(opened.device)
    with pytest.raises(DeviceLost, match="went away"):
        opened.link.write(b"!Y,0,0,0\n", time.monotonic() + PATIENCE_S)
    assert opened.files() == 0


def test_filling_goes_on_after_a_gap_and_gives_up_after_silence():
    opened = OpenedLink()
    data = os.urandom(30_000)
    timers = [
        threading.Timer(at_s, os.write, [opened.device, part])
        for at_s, part in ((0.05, data[:1000]), (0.3, data[1000:3000]))
    ]
    for timer in timers:
        timer.start()
    buffer = memoryview(bytearray(len(data)))
    start_s = time.monotonic()
    count = opened.link.fill(buffer, start_s + PATIENCE_S, 0.7, start_s + PATIENCE_S)
    assert time.monotonic() - start_s < PATIENCE_S, "silence ends it, not the end of all patience"
    assert bytes(buffer[:count]) == data[:3000]
    assert opened.link.read_into(buffer, time.monotonic()) == 0, "waiting as asked, as before"
    opened.link.close()
    os.close(opened.device)


@pytest.mark.parametrize("what", ["read", "fill", "write"])
def test_closing_in_another_thread_ends_what_waits_and_closes_the_descriptor(what):
    opened = OpenedLink()
    met = []

    def wait():
        end_s = time.monotonic() + 60
        try:
            if what == "read":
                opened.link.read_into(memoryview(bytearray(16)), end_s)
            elif what == "fill":
                opened.link.fill(memoryview(bytearray(16)), end_s, 60.0, end_s)
            else:
                opened.link.write(bytes(1_000_000), end_s)  # nobody takes it
        except DeviceLost as error:
            met.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    time.sleep(0.1)
    opened.link.close()
    thread.join(PATIENCE_S)
    assert not thread.is_alive()
    assert "closed" in met[0]
    assert opened.files() == 0
    opened.link.close()
    os.close(opened.device)


@pytest.fixture
def thousand_files():
    """As many open files as make the next one's descriptor larger than select knows."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 1200:
        pytest.skip(f"no more than {hard} files may be open here")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 1200), hard))
    files = [os.open(os.devnull, os.O_RDONLY)]
    while files[-1] < 1024:
        files.append(os.dup(files[0]))
    yield
    for file in files:
        os.close(file)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_process_with_more_than_a_thousand_open_files_can_ping(thousand_files, source):
    with Emulator(source) as emulator, open_serial(emulator.path) as device:
        device.configure(Settings(num_words=32_768))
        assert device.ping().ping_index == 0
