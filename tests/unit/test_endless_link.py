"""A link on which bytes always wait, faster than any pty: nothing may read it for ever."""

import time

import pytest

from ertis_driver.errors import DeviceBabbles, FrameCorrupt
from ertis_driver.exchanges import Exchanges
from ertis_driver.frame_reader import FrameReader


class EndlessLink:
    name = "endless"

    def write(self, data, deadline):
        pass

    def read_into(self, buffer, deadline):
        time.sleep(0.0005)
        buffer[:100] = bytes(100)
        return 100

    def close(self):
        pass


def test_a_frame_reader_gives_up():
    reader = FrameReader(
        EndlessLink(), 32_768, lambda _: True, listening_s=0.01, gap_s=0.1, slack_s=0.1
    )
    with pytest.raises(FrameCorrupt, match="ping again"):
        reader.read(time.monotonic() + 0.1)
    assert reader.bytes_lost > 1000


def test_settling_and_fencing_give_up():
    exchanges = Exchanges(EndlessLink(), 0.1)
    with pytest.raises(DeviceBabbles):
        exchanges.settle(0.1)
    with pytest.raises(DeviceBabbles):
        exchanges.fence(0x020304, 0.1)
    assert exchanges.bytes_lost > 1000
