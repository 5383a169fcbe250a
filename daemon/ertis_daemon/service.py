"""The service: one thread pings, the calling thread recognises and publishes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, Protocol, cast, get_args

from ertis_daemon.acquisition import Acquisition
from ertis_daemon.config import Config
from ertis_daemon.events import SCHEMA, Covariance, LandmarkEvent, LandmarkReport, TrackState
from ertis_daemon.frame_queue import FrameQueue, HeardPing
from ertis_daemon.pipeline import Heard, Pipeline, TrackLike
from ertis_daemon.status import Status
from ertis_driver.device import Sonar
from ertis_driver.errors import ErtisError
from ertis_driver.frame import PdmFrame

log = logging.getLogger(__name__)

STATUS_PERIOD_S = 1.0
POLL_S = 0.1  # how late a stop is seen
MAX_FAILURES = 10  # in a row
JOIN_S = 3.0  # a ping in progress: 36 ms of listening, 0.1 s of transfer, or its timeout


class ServiceError(ErtisError):
    """Ping after ping could not be processed: read the log, this is no single bad frame."""


class Publisher(Protocol):
    """Where events go."""

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event."""

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the counters."""

    def close(self) -> None:
        """Leave. May be called twice."""


class Service:
    """Pings, recognises and publishes until stopped; then closes sonar and publisher.

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
    """

    def __init__(
        self,
        sonar: Sonar,
        pipeline: Pipeline,
        publisher: Publisher,
        config: Config,
        stop: threading.Event | None = None,
    ) -> None:
        self.status = Status()
        self.stop = stop or threading.Event()
        self._sonar = sonar
        self._pipeline = pipeline
        self._publisher = publisher
        self._config = config
        self._failures = 0
        self._status_due_s = 0.0

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
        config = self._config
        paced = self._sonar.is_live or config.ping_rate_hz > 0
        queue = FrameQueue(config.queue_size, keep_newest=paced)
        acquisition = Acquisition(
            self._sonar,
            queue,
            self.status,
            self.stop,
            ping_rate_hz=config.ping_rate_hz,
            max_pings=config.max_pings,
        )
        with ExitStack() as stack:
            stack.callback(self._publisher.close)
            stack.callback(self._sonar.close)
            stack.callback(self._end, acquisition, queue)
            acquisition.start()
            self._loop(queue)
            self._publish_status()
        return self.status

    def _end(self, acquisition: Acquisition, queue: FrameQueue) -> None:
        self.stop.set()
        queue.abandon()
        acquisition.join(JOIN_S)
        if acquisition.is_alive():
            log.warning("a ping did not end within %g s, the sonar is closed under it", JOIN_S)

    def _loop(self, queue: FrameQueue) -> None:
        while not (self.stop.is_set() or queue.finished):
            ping = queue.get(POLL_S)
            if ping is not None:
                self._process(ping)
            if time.monotonic() >= self._status_due_s:
                self._publish_status()
        if not self.stop.is_set():
            queue.get(0.0)  # raises what the acquisition ended with

    def _publish_status(self) -> None:
        self._status_due_s = time.monotonic() + STATUS_PERIOD_S
        self._publisher.publish_status(self.status.to_json())

    def _process(self, ping: HeardPing) -> None:
        index = ping.frame.ping_index
        try:
            heard = self._pipeline.process(ping.frame)
            event = self._event(ping.frame, heard)
            if event is not None:
                self._publisher.publish(event)
        except Exception as error:
            self.status.pings_failed += 1
            self._failures += 1
            log.exception("ping %d could not be processed", index)
            if self._failures >= MAX_FAILURES:
                raise ServiceError(
                    f"{self._failures} pings in a row could not be processed, the last one "
                    f"(ping {index}) with {type(error).__name__}: {error}"
                ) from error
            return
        self._failures = 0
        self.status.half_words_repaired += heard.half_words_repaired
        self.status.odometry_garbled += heard.odometry_garbled
        self.status.pings_without_odometry += heard.without_odometry
        if event is None:
            return
        self.status.events += 1
        self.status.latencies_ms.append(1000.0 * (time.monotonic() - ping.arrived_s))
        log.debug("ping %d: %d landmarks", index, len(event.landmarks))

    def _event(self, frame: PdmFrame, heard: Heard) -> LandmarkEvent | None:
        if not heard.tracks:
            return None
        config = self._config
        return LandmarkEvent(
            schema=SCHEMA,
            device=config.device.name,
            ping_index=frame.ping_index,
            ping_time_ns=frame.ping_time_ns,
            time_uncertainty_ns=frame.time_uncertainty_ns,
            frame_id=config.device.frame_id,
            source=self._sonar.info.source,
            model=self._pipeline.model_name,
            landmarks=tuple(report(track) for track in heard.tracks),
            speed_of_sound_m_s=config.speed_of_sound_m_s,
            temperature_c=config.temperature_c,
        )


def report(track: TrackLike) -> LandmarkReport:
    """A track as events report it."""
    if track.state not in get_args(TrackState):
        raise ValueError(f"track state {track.state!r}, expected new, update or lost")
    heard = track.detection
    return LandmarkReport(
        track_id=track.track_id,
        state=cast("TrackState", track.state),
        label=heard.label,
        probabilities=dict(heard.probabilities),
        range_m=heard.range_m,
        azimuth_rad=heard.azimuth_rad,
        elevation_rad=heard.elevation_rad,
        covariance=cast("Covariance", heard.covariance),
        snr_db=heard.snr_db,
        radius_m=heard.radius_m,
    )
