import threading
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ertis_daemon.acquisition import PingRequests
from ertis_daemon.config import Config, RecordConfig
from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.pipeline import Heard
from ertis_daemon.recording.recorder import Recorder
from ertis_daemon.service import Service, ServiceError
from ertis_daemon.serving.outputs import FanOut
from ertis_daemon.status import Status
from ertis_detector.detection import Detection
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.errors import DeviceLost, DeviceTimeout, EndOfRecording, FrameCorrupt, PingLost
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, read_recording

WORDS = np.zeros(10, np.uint32)
DETECTION = Detection(
    "r48", {"r48": 1.0}, 1.0, 0.0, 0.0, ((0.0,) * 3, (0.0,) * 3, (0.0,) * 3), snr_db=20.0
)


@dataclass
class ListedTrack:
    track_id: int = 1
    state: str = "new"
    detection: Detection = DETECTION


class ListSonar:
    """Plays a list of ping indices and errors; then the recording ends."""

    def __init__(self, script, *, live=False, pause_s=0.0):
        self.script = iter(script)
        self.is_live = live
        self.info = DeviceInfo("list:", "live" if live else "sim")
        self.settings = Settings()
        self.closed = 0
        self.pause_s = pause_s
        self.times = []

    def configure(self, settings):
        self.settings = settings

    def ping(self, *, active=True):
        self.times.append(time.monotonic())
        time.sleep(self.pause_s)
        item = next(self.script, EndOfRecording("over"))
        if isinstance(item, Exception):
            raise item
        return PdmFrame(WORDS, item, 1000 + item)

    def close(self):
        self.closed += 1

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.close()


class OneTrack:
    """Hears the same landmark in each ping, but in those that it is told to fail on."""

    model_name = "fake"
    classes = ("r48",)

    def __init__(self, fail=(), silent=(), pause_s=0.0):
        self.fail, self.silent, self.pause_s = fail, silent, pause_s
        self.seen = []

    def process(self, frame):
        time.sleep(self.pause_s)
        self.seen.append(frame.ping_index)
        if frame.ping_index in self.fail:
            raise ValueError("bad ping")
        return Heard([] if frame.ping_index in self.silent else [ListedTrack()], 2, 1, True)


class ListPublisher:
    name = "list"

    def __init__(self):
        self.events, self.statuses, self.raw = [], [], []

    def publish(self, event):
        self.events.append(event)

    def publish_status(self, status):
        self.statuses.append(status)

    def publish_raw(self, frame):
        self.raw.append(frame.ping_index)


def make(script, pipeline=None, *, live=False, pause_s=0.0, **config):
    sonar = ListSonar(script, live=live, pause_s=pause_s)
    return Service(sonar, pipeline or OneTrack(), ListPublisher(), Config(**config))


def parts(service):
    return service._sonar, service._pipeline, service._publisher


def test_each_ping_with_a_landmark_is_one_event_in_order():
    service = make(range(20), OneTrack(silent=(3,)))
    status = service.run()
    sonar, _, publisher = parts(service)
    assert [e.ping_index for e in publisher.events] == [n for n in range(20) if n != 3]
    event = publisher.events[0]
    assert (event.source, event.model, event.ping_time_ns) == ("sim", "fake", 1000)
    assert event.landmarks[0].radius_m == 0.048
    assert (status.pings_heard, status.events, status.queue_drops) == (20, 19, 0)
    assert status.half_words_repaired == 40
    assert (status.odometry_garbled, status.pings_without_odometry) == (20, 20)
    assert len(status.latencies_ms) == 19
    assert sonar.closed == 1
    assert publisher.statuses[-1]["pings_heard"] == 20


def test_corrupt_frames_timeouts_and_gaps_are_counted_and_survived():
    script = [0, FrameCorrupt("x"), 2, *[DeviceTimeout("t")] * 5, 3, DeviceTimeout("t"), 7, 0]
    status = make(script).run()
    assert (status.pings_heard, status.frames_corrupt, status.timeouts) == (5, 1, 6)
    assert status.pings_lost == 1 + 3  # index 1, and 4 to 6; the counter set back is no loss


def test_the_counter_may_wrap():
    assert make([2**32 - 1, 1]).run().pings_lost == 1


def test_an_unplugged_sonar_that_reconnects_is_waited_for_and_counted():
    service = make([0, *[PingLost("away")] * 20, 1])
    status = service.run()
    assert (status.pings_heard, status.pings_away, status.timeouts) == (2, 20, 0)


def test_six_timeouts_in_a_row_end_it_with_that_error():
    service = make([0, *[DeviceTimeout("silent")] * 6])
    with pytest.raises(DeviceTimeout, match="silent"):
        service.run()
    sonar, _, publisher = parts(service)
    assert [e.ping_index for e in publisher.events] == [0]
    assert sonar.closed == 1


def test_timeouts_before_and_after_an_unplug_are_not_in_a_row():
    silent = [DeviceTimeout("silent")] * 5
    assert make([0, *silent, PingLost("away"), *silent, 1]).run().timeouts == 10


def test_a_lost_device_ends_it_after_what_was_heard():
    service = make([0, 1, DeviceLost("gone")])
    with pytest.raises(DeviceLost, match="gone"):
        service.run()
    assert [e.ping_index for e in parts(service)[2].events] == [0, 1]


def test_nine_bad_pings_in_a_row_are_survived_and_ten_are_not():
    status = make(range(30), OneTrack(fail=[*range(9), *range(10, 19)])).run()
    assert (status.pings_failed, status.events) == (18, 12)
    service = make(range(30), OneTrack(fail=range(5, 30)))
    with pytest.raises(ServiceError, match=r"ping 14\) with ValueError: bad ping"):
        service.run()
    assert parts(service)[0].closed == 1


def test_a_live_sonar_loses_the_oldest_waiting_pings_to_a_slow_detector():
    service = make(range(40), OneTrack(pause_s=0.02), live=True, pause_s=0.002)
    status = service.run()
    seen = parts(service)[1].seen
    assert status.queue_drops > 10
    assert len(seen) + status.queue_drops == 40
    assert seen[-1] == 39
    assert seen == sorted(seen)


def test_max_pings_ends_it():
    assert make(range(100), max_pings=7).run().events == 7


def test_pings_are_paced():
    service = make(range(6), ping_rate_hz=50.0)
    service.run()
    times = parts(service)[0].times
    assert times[5] - times[0] >= 5 * 0.02 - 0.002


def test_pings_after_one_that_took_long_keep_their_pace():
    class Stalling(ListSonar):
        def ping(self, *, active=True):
            time.sleep(0.0 if self.times else 0.3)
            return super().ping(active=active)

    sonar = Stalling(range(6))
    Service(sonar, OneTrack(), ListPublisher(), Config(ping_rate_hz=25.0)).run()
    assert sonar.times[5] - sonar.times[0] >= 4 * 0.04 - 0.002  # only the one that was due at once


def test_no_more_than_a_hundred_pings_on_command_wait():
    requests = PingRequests()
    assert [requests.ask(count) for count in (80, 80, 1)] == [80, 100, 100]
    assert sum(requests.take(0.0) for _ in range(150)) == 100


def test_a_stop_ends_it_promptly_and_closes_both():
    service = make(iter(range(10**9)), live=True, pause_s=0.005)
    threading.Timer(0.2, service.stop.set).start()
    start = time.monotonic()
    service.run()
    assert time.monotonic() - start < 10.0
    assert parts(service)[0].closed == 1
    assert not any(t.name == "acquisition" for t in threading.enumerate())


def test_a_ping_that_is_dropped_leaves_the_step_of_the_clock_to_the_next():
    queue = FrameQueue(2, keep_newest=True)
    for index, step_ns in enumerate([7, 0, 20, 0, -3]):
        queue.put(HeardPing(PdmFrame(WORDS, index, 0, clock_step_ns=step_ns), 0.5))
    taken = [queue.get(0.0) for _ in range(2)]
    assert [(one.frame.ping_index, one.frame.clock_step_ns) for one in taken] == [(3, 27), (4, -3)]
    assert taken[0].arrived_s == 0.5
    assert taken[0].frame.words is WORDS


def test_a_full_queue_that_is_abandoned_lets_its_producer_go():
    queue = FrameQueue(1, keep_newest=False)
    ping = HeardPing(PdmFrame(WORDS, 0, 0), 0.0)
    queue.put(ping)
    producer = threading.Thread(target=queue.put, args=(ping,))
    producer.start()
    producer.join(0.05)
    assert producer.is_alive()
    queue.abandon()
    producer.join(1.0)
    assert not producer.is_alive()


class NoEvents(ListPublisher):
    """Refuses events."""

    def publish(self, event):
        raise OSError("no way out")


@pytest.mark.parametrize(("others", "events"), [(1, 30), (0, 0)])
def test_an_output_that_always_fails_costs_its_own_events_and_no_sonar(others, events):
    status, plain = Status(), [ListPublisher() for _ in range(others)]
    sonar = ListSonar(range(30))
    outputs = FanOut([*plain, NoEvents()], status)
    Service(sonar, OneTrack(), outputs, Config(), status=status).run()
    assert (status.events, status.pings_failed, status.publish_failures) == (events, 0, 30)
    assert [len(one.events) for one in plain] == [30] * others
    assert list(status.outputs_failing) == ["list events"]


def test_a_ping_that_cannot_be_processed_is_logged_by_its_index_and_kept(tmp_path, caplog):
    status = Status()
    recorder = Recorder(
        RecordConfig(folder=str(tmp_path), keep_free_mb=0), "s", status, keeps_ring=False
    )
    info = RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=WORDS.size)
    recorder.begin(info)
    service = Service(
        ListSonar(range(5)), OneTrack(fail=(3,)), ListPublisher(), Config(), recorder=recorder
    )
    service.run()
    recorder.close()
    assert [e.ping_index for e in service._publisher.events] == [0, 1, 2, 4]
    (path,) = tmp_path.iterdir()
    assert path.name.endswith("-failed-ping-3.mcap")
    assert [ping.frame.ping_index for ping in read_recording(path)] == [3]
    (told,) = [record for record in caplog.records if record.levelname == "ERROR"]
    assert told.getMessage() == f"ping 3 could not be processed, it is kept: {path}"
    assert "ValueError: bad ping" in caplog.text


def test_what_fails_after_the_event_is_out_costs_neither_event_nor_ping(caplog):
    class NoRaw(ListPublisher):
        def publish_raw(self, frame):
            raise OSError("no way out")

    service = Service(ListSonar(range(3)), OneTrack(), NoRaw(), Config())
    status = service.run()
    assert (status.events, status.pings_failed) == (3, 0)
    assert "its event is out, the rest failed" in caplog.text


def test_the_watchdog_is_fed_by_the_loop_and_starves_when_the_driver_hangs():
    beats, release = [], threading.Event()

    class Hanging(ListSonar):
        def ping(self, *, active=True):
            if self.times:
                release.wait(10.0)
            return super().ping(active=active)

    service = Service(
        Hanging(range(2), live=True),
        OneTrack(),
        ListPublisher(),
        Config(),
        beat=lambda: beats.append(time.monotonic()),
        stall_s=0.3,
    )
    running = threading.Thread(target=service.run)
    running.start()
    try:
        deadline = time.monotonic() + 10.0
        while service.status.state != "stalled":
            assert time.monotonic() < deadline
            time.sleep(0.01)
        assert beats
        count = len(beats)
        time.sleep(0.4)
        assert len(beats) == count
        assert service._publisher.statuses[-1]["state"] == "stalled"
    finally:
        release.set()
        running.join()
    assert service.status.state == "running"


def test_a_clock_that_was_set_is_counted():
    class Stepping(ListSonar):
        def ping(self, *, active=True):
            frame = super().ping(active=active)
            return replace(frame, clock_step_ns=10**9 if frame.ping_index == 2 else 0)

    service = Service(Stepping(range(5)), OneTrack(), ListPublisher(), Config())
    assert service.run().clock_steps == 1


def test_a_new_landmark_starts_a_recording_and_a_known_one_does_not(tmp_path):
    class New(OneTrack):
        def process(self, frame):
            heard = super().process(frame)
            state = "new" if frame.ping_index == 2 else "update"
            return replace(heard, tracks=[ListedTrack(state=state)])

    config = Config(
        record=RecordConfig(folder=str(tmp_path), on=("new",), keep_free_mb=0, after_s=0.0)
    )
    recorder = Recorder(config.record, "s", Status(), keeps_ring=True)
    recorder.begin(RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=WORDS.size))
    sonar = ListSonar(range(6), pause_s=0.01)
    Service(sonar, New(), ListPublisher(), config, recorder=recorder).run()
    recorder.close()
    (path,) = tmp_path.iterdir()
    assert path.name.endswith("-new.mcap")
    assert {0, 1, 2} <= {ping.frame.ping_index for ping in read_recording(path)}


def test_a_recording_that_has_no_place_to_go_is_counted_and_costs_no_event(tmp_path, caplog):
    (tmp_path / "rec").write_text("a file")
    config = Config(record=RecordConfig(folder=str(tmp_path / "rec"), on=("new",)))
    status = Status()
    recorder = Recorder(config.record, "s", status, keeps_ring=True)
    recorder.begin(RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=WORDS.size))
    publisher = ListPublisher()
    Service(
        ListSonar(range(3)), OneTrack(), publisher, config, status=status, recorder=recorder
    ).run()
    recorder.close()
    assert (status.events, status.pings_failed) == (3, 0)
    assert status.recordings_failed >= 1
    assert "nothing recorded: cannot make" in caplog.text
