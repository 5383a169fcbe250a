import os
import select
import socket
import threading
import tty

import numpy as np
import pytest
from daemon_rig import (  # noqa: F401  # fixtures
    heard_landmarks,
    landmark_sonar,
    open_zenoh,
    start_daemon,
    start_program,
)

from ertis_driver.emulator import Emulator
from ertis_driver.firmware import FirmwareState


class SyntheticSource:
    """Frames that differ from ping to ping; remembers what it was asked."""

    def __init__(self):
        self.requests = []

    def next_frame(self, request):
        self.requests.append(request)
        return self.words(request.index, request.num_words, active=request.active)

    @staticmethod
    def words(index, num_words, *, active):
        rng = np.random.default_rng([index, active])
        return rng.integers(0, 2**32, num_words, dtype=np.uint32)


@pytest.fixture
def source():
    return SyntheticSource()


@pytest.fixture
def emulator(source):
    with Emulator(source) as emulator:
        yield emulator


class BarePty:
    """A raw pty with nobody behind it."""

    def __init__(self):
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.path = os.ttyname(self.slave)
        self.is_open = True

    def hang_up(self):
        if self.is_open:  # a number closed twice may be somebody else's by then
            self.is_open = False
            os.close(self.slave)
            os.close(self.master)


@pytest.fixture
def bare_pty():
    pty = BarePty()
    yield pty
    pty.hang_up()


def send_all(master, data, stop):
    """Write all of it, unless nobody reads any more."""
    while data and not stop.is_set():
        if select.select([], [master], [], 0.02)[1]:
            try:
                data = data[os.write(master, data) :]
            except BlockingIOError:
                continue


def serve_state(master, state, change, stop):
    """The firmware with faults: ``change`` gets each reply and returns what is sent, or None."""
    os.set_blocking(master, False)
    while not stop.is_set():
        if not select.select([master], [], [], 0.02)[0]:
            continue
        data = os.read(master, 4096)
        for reply in state.feed(data):
            reply = change(reply)
            if reply is None:
                return
            send_all(master, reply, stop)


@pytest.fixture
def faulty(bare_pty, source):
    """Starts firmware whose replies a function may change."""
    stop = threading.Event()
    threads = []

    def start(change, state=None):
        state = state or FirmwareState(source)
        thread = threading.Thread(target=serve_state, args=(bare_pty.master, state, change, stop))
        thread.start()
        threads.append(thread)
        return bare_pty.path

    start.master = bare_pty.master
    start.send = lambda data: send_all(bare_pty.master, data, stop)
    yield start
    stop.set()
    for thread in threads:
        thread.join()


@pytest.fixture
def emulator_pair():
    """Two emulators with sources of their own, of opposite trigger forms: (path, source) each."""
    first, second = SyntheticSource(), SyntheticSource()
    with Emulator(first) as a, Emulator(second) as b:
        b.state = FirmwareState(second, trigger_form="windows")
        yield (a.path, first), (b.path, second)


@pytest.fixture
def free_locator():
    """A function that finds a Zenoh locator nobody listens on."""

    def find():
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return f"tcp/127.0.0.1:{probe.getsockname()[1]}"

    return find
