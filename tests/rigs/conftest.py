import os
import tty

import numpy as np
import pytest

from ertis_driver.emulator import Emulator


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
