import threading
import time
from dataclasses import dataclass

import numpy as np
import pytest

from ertis_daemon.config import Config
from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.pipeline import Heard
from ertis_daemon.service import Service, ServiceError
from ertis_detector.detection import Detection
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.errors import DeviceLost, DeviceTimeout, EndOfRecording, FrameCorrupt, PingLost
from ertis_driver.frame import PdmFrame

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
    def __init__(self):
        self.events, self.statuses, self.closed = [], [], 0

    def publish(self, event):
        self.events.append(event)

    def publish_status(self, status):
        self.statuses.append(status)

    def close(self):
        self.closed += 1


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
    assert (sonar.closed, publisher.closed) == (1, 1)
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
    assert (sonar.closed, publisher.closed) == (1, 1)


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
    assert (parts(service)[0].closed, parts(service)[2].closed) == (1, 1)


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


def test_a_stop_ends_it_promptly_and_closes_both():
    service = make(iter(range(10**9)), live=True, pause_s=0.005)
    threading.Timer(0.2, service.stop.set).start()
    start = time.monotonic()
    service.run()
    assert time.monotonic() - start < 10.0
    sonar, _, publisher = parts(service)
    assert (sonar.closed, publisher.closed) == (1, 1)
    assert not any(t.name == "acquisition" for t in threading.enumerate())


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


def test_a_publisher_that_fails_costs_a_ping_only():
    class Failing(ListPublisher):
        def publish(self, event):
            if event.ping_index == 1:
                raise OSError("no way out")
            super().publish(event)

    service = Service(ListSonar(range(3)), OneTrack(), Failing(), Config())
    status = service.run()
    assert (status.pings_failed, status.events) == (1, 2)
