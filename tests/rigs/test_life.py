"""The life of one sonar that fails and works, over a pty: how long it is left alone, and when."""

import time
from contextlib import ExitStack

import pytest
from patience import wait_for

from ertis_daemon.acquisition import MAX_DAMAGED
from ertis_daemon.config_read import parse_config
from ertis_daemon.serving.backoff import Backoff
from ertis_daemon.serving.life import SonarLife
from ertis_driver.emulator import Emulator
from ertis_driver.firmware import FirmwareState

FIRST_S, LAST_S = 0.2, 1.6  # far enough apart for a busy machine


class Moody(FirmwareState):
    """Its chirp memory does not work for so many tries; notes how long each was waited for.

    It stutters at one command, once, if told so.
    """

    def __init__(self, source):
        self.bad_tries = 0
        self.stutters_at = None
        self.pauses_s = []
        self._last = ("", 0.0)
        self._hashes = 0
        super().__init__(source)

    def restart(self, bad_tries):
        self.bad_tries = bad_tries
        self.reset()

    def _take(self, line):
        letter, now_s = line[1:2].decode(), time.monotonic()
        if self._last[0] + letter == "LY":  # the chirp was found wrong, and this is the next try
            self.pauses_s.append(now_s - self._last[1])
            self.bad_tries -= 1
        self._last = letter, now_s
        reply = super()._take(line)
        if letter == self.stutters_at:
            self.stutters_at = None
            return reply + b"\0"
        if letter == "L" and self.bad_tries:
            self._hashes += 1  # never the same twice: it would be taken for the rest of the memory
            return self._hashes.to_bytes(4, "little")
        return reply


@pytest.fixture
def plug(source, tmp_path):
    """Plugs in a sonar; to close it unplugs it."""
    with ExitStack() as stack:

        def plug():
            sonar = stack.enter_context(Emulator(source, link=tmp_path / "port"))
            sonar.state = Moody(source)
            return sonar

        yield plug


@pytest.fixture
def device(plug):
    return plug().state


@pytest.fixture
def live(tmp_path):
    """Starts the life of that sonar."""
    lives = []

    def start(text, **options):
        text = f"device: {{address: 'serial:{tmp_path}/port'}}\n{text}"
        (config,) = parse_config(text.encode()).each_sonar()
        lives.append(SonarLife(config, [], **options))
        lives[-1].start()
        return lives[-1]

    yield start
    for life in lives:
        life.stop()
        life.join(10.0)
        assert not life.is_alive()


def test_a_sonar_that_fails_is_left_alone_for_longer_each_time_until_it_worked(device, live):
    device.restart(bad_tries=3)
    life = live("ping_rate_hz: 10", backoff=Backoff(FIRST_S, LAST_S))
    wait_for(lambda: life.status.pings_heard)
    pauses_s, device.pauses_s = device.pauses_s, []
    for pause_s, least_s in zip(pauses_s, (0.2, 0.4, 0.8), strict=True):
        assert pause_s >= least_s

    heard_s = life.status.heard_s
    wait_for(lambda: heard_s[-1] - heard_s[0] > LAST_S + 0.1)
    device.restart(bad_tries=2)
    wait_for(lambda: life.status.starts == 2)
    once, twice = device.pauses_s
    assert FIRST_S <= once < LAST_S
    assert twice >= 2 * FIRST_S, "it has not worked since"


def test_a_sonar_that_comes_back_has_not_been_in_trouble(plug, live):
    sonar = plug()
    sonar.state.restart(bad_tries=9)
    life = live("num_words: 65536\n", backoff=Backoff(FIRST_S, LAST_S))
    wait_for(lambda: len(sonar.state.pauses_s) == 3)
    sonar.close()
    wait_for(lambda: life.status.state == "waiting")
    back = plug().state
    back.restart(bad_tries=1)
    wait_for(lambda: life.status.pings_heard)
    (pause_s,) = back.pauses_s
    assert FIRST_S <= pause_s < LAST_S


def test_a_sonar_that_restarted_with_frames_of_another_size_is_opened_again(device, live):
    life = live("num_words: 65536\nping_rate_hz: 20\n", backoff=Backoff(FIRST_S, LAST_S))
    wait_for(lambda: life.status.pings_heard)
    device.restart(bad_tries=0)
    wait_for(lambda: life.status.starts == 2)
    heard = life.status.pings_heard
    wait_for(lambda: life.status.pings_heard > heard)
    assert life.status.frames_corrupt == MAX_DAMAGED + 1


def test_a_sonar_whose_answers_are_out_of_step_is_opened_again(device, live):
    device.stutters_at = "I"
    life = live("num_words: 65536\n", backoff=Backoff(FIRST_S, LAST_S))
    wait_for(lambda: life.status.pings_heard or life.error)
    assert (life.error, life.status.starts) == (None, 1)
