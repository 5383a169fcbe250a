import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from test_recording import INFO, NUM_WORDS, make_frame, write

from ertis_driver.device import Settings
from ertis_driver.errors import AddressError, EndOfRecording, SettingsError
from ertis_driver.firmware import PingRequest
from ertis_driver.open import open_device
from ertis_driver.recording import RecordingWriter
from ertis_driver.replay_source import ReplaySource

PERIOD_NS = make_frame(1).ping_time_ns - make_frame(0).ping_time_ns


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write(tmp_path_factory.mktemp("recording") / "hall.mcap")


def pings_of(address, count):
    with open_device(address) as sonar:
        sonar.configure(Settings())
        return [sonar.ping() for _ in range(count)]


def test_a_loop_goes_round_and_its_times_go_on(recording):
    frames = pings_of(f"replay:{recording}?loop=1", 8)
    assert [frame.ping_index for frame in frames] == [0, 1, 2, 0, 1, 2, 0, 1]
    steps = np.diff([frame.ping_time_ns for frame in frames])
    assert set(steps.tolist()) == {PERIOD_NS}
    np.testing.assert_array_equal(frames[4].words, make_frame(1).words)


def test_a_loop_of_one_ping_moves_on_by_what_it_listens(tmp_path):
    write(tmp_path / "a.mcap", num_pings=1)
    first, second = pings_of(f"replay:{tmp_path / 'a.mcap'}?loop=1", 2)
    assert second.ping_time_ns - first.ping_time_ns == round(NUM_WORDS / 4.5e6 * 1e9)


def test_a_loop_of_nothing_ends(tmp_path):
    write(tmp_path / "a.mcap", num_pings=0)
    with pytest.raises(EndOfRecording):
        pings_of(f"replay:{tmp_path / 'a.mcap'}?loop=1", 1)


def test_half_the_rate_takes_twice_the_time(recording):
    started_s = time.monotonic()
    pings_of(f"replay:{recording}?rate=0.5", 3)
    assert time.monotonic() - started_s >= 4 * PERIOD_NS / 1e9


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_a_clock_that_was_set_while_it_was_recorded_is_not_waited_for(tmp_path, step_s):
    step_ns = step_s * 10**9
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        for index in range(4):
            frame = make_frame(index)
            if index >= 2:
                frame = replace(frame, ping_time_ns=frame.ping_time_ns + step_ns)
            writer.write(replace(frame, clock_step_ns=step_ns if index == 2 else 0))
    started_s = time.monotonic()
    frames = pings_of(f"replay:{tmp_path / 'a.mcap'}?rate=1&loop=1", 9)
    assert 8 * PERIOD_NS / 1e9 <= time.monotonic() - started_s < 100.0
    set_by_ns = np.cumsum([frame.clock_step_ns for frame in frames])
    steps = np.diff([frame.ping_time_ns for frame in frames] - set_by_ns)
    assert set(steps.tolist()) == {PERIOD_NS}


def test_a_file_whose_name_holds_a_question_mark_is_that_file(tmp_path):
    path = write(tmp_path / "why?rate=x")
    assert len(pings_of(f"replay:{path}", 3)) == 3
    assert len(pings_of(f"replay:{path}?loop=1", 4)) == 4


@pytest.mark.parametrize("options", ["rate=fast", "loop=maybe", "speed=2", "rate=1&x=2"])
def test_an_unknown_option_is_named(recording, options):
    with pytest.raises(AddressError, match="expected"):
        open_device(f"replay:{recording}?{options}")


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "1e9"])
def test_a_rate_that_cannot_be_is_refused(recording, rate):
    with pytest.raises(SettingsError, match=r"expected 0\.001 to 1000"):
        open_device(f"replay:{recording}?rate={rate}")


def test_a_closed_replay_does_not_wait_on(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        for index in (0, 1_000_000):
            writer.write(make_frame(index))
    sonar = open_device(f"replay:{tmp_path / 'a.mcap'}?rate=1")
    sonar.configure(Settings())
    sonar.ping()
    threading.Timer(0.1, sonar.close).start()
    with pytest.raises(Exception, match="closed"):
        sonar.ping()


def test_a_source_that_plays_once_says_when_it_is_over(recording):
    over = threading.Event()
    source = ReplaySource(recording, loop=False, stop=over)
    request = PingRequest(0, NUM_WORDS, np.zeros(64, np.uint16), 450_000, True)
    for index in range(3):
        np.testing.assert_array_equal(source.next_frame(request), make_frame(index).words)
        assert not over.is_set()
    with pytest.raises(EndOfRecording):
        source.next_frame(request)
    assert over.is_set()
