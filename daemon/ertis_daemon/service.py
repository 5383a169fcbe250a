"""The service of one open sonar: one thread pings, the calling thread recognises and publishes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack

from ertis_daemon.acquisition import Acquisition, Pace
from ertis_daemon.config import SonarConfig
from ertis_daemon.event_of import event_of
from ertis_daemon.events import LandmarkEvent
from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.microphones import MicrophoneWatch
from ertis_daemon.pipeline import Heard, Pipeline
from ertis_daemon.recording.folder import NoRoom
from ertis_daemon.recording.recorder import Recorder
from ertis_daemon.serving.outputs import NoWayOut, Publisher
from ertis_daemon.serving.reporter import Reporter
from ertis_daemon.status import Status
from ertis_driver.audio import whole_samples
from ertis_driver.device import Sonar
from ertis_driver.errors import ErtisError
from ertis_driver.frame import PdmFrame

log = logging.getLogger(__name__)

POLL_S = 0.1  # how late a stop is seen
MAX_FAILURES = 10  # in a row
JOIN_S = 2.0  # a ping in progress: 36 ms of listening, 0.1 s of transfer
STALL_S = 20.0  # no driver call takes as long: a silent device is given up after 6 s


class ServiceError(ErtisError):
    """Ping after ping could not be processed: read the log, this is no single bad frame."""


def _nothing() -> None: ...


class Service:
    """Pings, recognises and publishes until stopped; then closes the sonar.

    Parameters
    ----------
    sonar
        Configured.
    pipeline, publisher
        What to do with a frame, and with what it told.
    config
        For names, rate, queue and the air.
    stop
        Set it, from a signal handler or thread, to end ``run``.
    status
        Counted on; a new one if not given.
    pace
        When to ping; as ``config`` says if not given.
    recorder
        Gets each frame, and is told what is worth a recording.
    beat
        Called by the loop as long as pinging and processing go on: feeds the watchdog.
    reporter
        Publishes the status.
    stall_s
        A driver that does not return for so long hangs.
    """

    def __init__(
        self,
        sonar: Sonar,
        pipeline: Pipeline,
        publisher: Publisher,
        config: SonarConfig,
        stop: threading.Event | None = None,
        *,
        status: Status | None = None,
        pace: Pace | None = None,
        recorder: Recorder | None = None,
        beat: Callable[[], None] = _nothing,
        reporter: Reporter | None = None,
        stall_s: float = STALL_S,
    ) -> None:
        self.status = status or Status()
        self.stop = stop or threading.Event()
        self._sonar = sonar
        self._pipeline = pipeline
        self._publisher = publisher
        self._config = config
        self._pace = pace or Pace(config.ping_on, config.ping_rate_hz, config.max_pings)
        self._recorder = recorder
        self._beat = beat
        self._reporter = reporter or Reporter(self.status, publisher)
        self._stall_s = stall_s
        self._microphones = MicrophoneWatch()
        self._failures = 0
        self._halt = threading.Event()

    def run(self) -> Status:
        """Work until stopped, until the recording ends or until ``max_pings`` were heard.

        A live sonar, or one paced by ``ping_rate_hz``, loses the oldest waiting ping if the
        detector is too slow. A recording or simulation that runs as fast as it goes waits instead.

        Returns
        -------
        Status
            The final counters.

        Raises
        ------
        DeviceError
            The sonar is lost or stays silent.
        ServiceError
            Ten pings in a row could not be processed.
        """
        paced = self._sonar.is_live or self._pace.ping_rate_hz > 0
        queue = FrameQueue(self._config.queue_size, keep_newest=paced)
        acquisition = Acquisition(
            self._sonar, queue, self.status, self._halt, self._pace, *self._hearing()
        )
        self._describe()
        with ExitStack() as stack:
            stack.callback(self._sonar.close)
            stack.callback(self._end, acquisition, queue)
            acquisition.start()
            self._loop(queue, acquisition)
        self._reporter.publish()
        return self.status

    def _hearing(self) -> Sequence[Callable[[PdmFrame], None]]:
        return [self._recorder.heard] if self._recorder else []

    def _describe(self) -> None:
        self.status.model = self._pipeline.model_name
        self.status.source = self._sonar.info.source
        self.status.temperature_c = self._config.temperature_c
        self.status.speed_of_sound_m_s = self._config.air.speed_of_sound_m_s

    def _end(self, acquisition: Acquisition, queue: FrameQueue) -> None:
        self._halt.set()
        queue.abandon()
        acquisition.join(JOIN_S)
        if acquisition.is_alive():
            log.warning("a ping did not end within %g s, the sonar is closed under it", JOIN_S)

    def _loop(self, queue: FrameQueue, acquisition: Acquisition) -> None:
        while not (self.stop.is_set() or queue.finished):
            ping = queue.get(POLL_S)
            if ping is not None:
                self._process(ping)
            if time.monotonic() - acquisition.sign_of_life_s < self._stall_s:
                self._beat()
            elif self.status.state != "stalled":
                self.status.state = "stalled"
                log.error("the driver has not returned for %g s", self._stall_s)
            self._reporter.tick()
        if not self.stop.is_set():
            queue.get(0.0)  # raises what the acquisition ended with

    def _process(self, ping: HeardPing) -> None:
        frame = ping.frame
        try:
            heard = self._pipeline.process(frame)
            event = None
            if heard.tracks:
                source, model = self._sonar.info.source, self._pipeline.model_name
                event = event_of(frame, heard.tracks, self._config, source=source, model=model)
            if event is not None:
                self._publisher.publish(event)
                published_s = time.monotonic()
        except NoWayOut:  # told there; that the sonar were opened anew would not help
            event = None
        except Exception as error:  # noqa: BLE001  # told, and counted, there
            self._failed(frame, error)
            return
        self._failures = 0
        self.status.half_words_repaired += heard.half_words_repaired
        self.status.odometry_garbled += heard.odometry_garbled
        self.status.pings_without_odometry += heard.without_odometry
        if event is not None:
            self.status.events += 1
            if self._recorder is not None and self._recorder.wants_events:
                self._recorder.published(event.to_json(), frame.ping_time_ns)
            self._late(event, 1000.0 * (published_s - ping.arrived_s))
        self._afterwards(frame, heard)

    def _late(self, event: LandmarkEvent, latency_ms: float) -> None:
        self.status.latencies_ms.append(latency_ms)
        log.debug(
            "ping %d: %d landmarks, %.1f ms after its last byte",
            event.ping_index,
            len(event.landmarks),
            latency_ms,
        )

    def _afterwards(self, frame: PdmFrame, heard: Heard) -> None:
        """What can wait until the event is out."""
        try:
            states: set[str] = {track.state for track in heard.tracks}
            if heard.decoded is not None and self._microphones.is_due:
                dead = self._microphones.check(whole_samples(frame.words), heard.decoded)
                self._tell_microphones(frame.ping_index, dead)
                states |= {"dead"} if dead else set()
            self._publisher.publish_raw(frame)
            self._record_if(states.intersection(self._config.record.on))
        except Exception:
            log.exception("ping %d: its event is out, the rest failed", frame.ping_index)

    def _tell_microphones(self, index: int, dead: Sequence[str]) -> None:
        self.status.microphones_faulty = faulty = self._microphones.faulty
        self.status.noise_dbfs = self._microphones.noise_dbfs
        for row in dead:
            log.warning("ping %d: microphone %s is %s", index, row, faulty[row])

    def _record_if(self, reasons: set[str]) -> None:
        if self._recorder is None or not reasons:
            return
        try:
            self._recorder.trigger("-".join(sorted(reasons)))
        except NoRoom as error:
            self._recorder.failed(error)

    def _failed(self, frame: PdmFrame, error: Exception) -> None:
        index = frame.ping_index
        self.status.pings_failed += 1
        self._failures += 1
        saved = self._recorder.save(frame, f"failed-ping-{index}") if self._recorder else None
        log.error(
            "ping %d could not be processed%s",
            index,
            f", it is kept: {saved}" if saved else "",
            exc_info=error,
        )
        if self._failures >= MAX_FAILURES:
            raise ServiceError(
                f"{self._failures} pings in a row could not be processed, the last one "
                f"(ping {index}) with {type(error).__name__}: {error}"
            ) from error
