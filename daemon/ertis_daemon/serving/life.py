"""The life of one sonar: waited for, opened, served, and opened again when it failed."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from ertis_daemon.acquisition import Pace, PingRequests
from ertis_daemon.config import SonarConfig
from ertis_daemon.odometry import POSES_WAITING, Odometry
from ertis_daemon.pipeline import Pipeline, build_pipeline
from ertis_daemon.recording.recorder import Recorder
from ertis_daemon.service import Service, ServiceError
from ertis_daemon.serving.about import sonar_info
from ertis_daemon.serving.backoff import Backoff
from ertis_daemon.serving.outputs import FanOut, Output
from ertis_daemon.serving.reload import load_detector
from ertis_daemon.serving.reporter import Reporter
from ertis_daemon.status import State, Status
from ertis_daemon.turns import Turns
from ertis_driver.device import Settings, Sonar
from ertis_driver.errors import (
    DeviceBabbles,
    DeviceBusy,
    DeviceLost,
    DeviceNotFound,
    DevicePermission,
    DeviceTimeout,
    FrameCorrupt,
    OutOfStep,
    PingLost,
    UploadFailed,
)
from ertis_driver.open import is_hardware, open_device
from ertis_driver.recording import RecordingInfo

if TYPE_CHECKING:
    from ertis_detector.detector import LandmarkDetector

log = logging.getLogger(__name__)

ABSENT = (DeviceNotFound, DevicePermission, DeviceBusy, DeviceLost, PingLost)
TROUBLED = (DeviceTimeout, DeviceBabbles, UploadFailed, OutOfStep, FrameCorrupt, ServiceError)
ABSENT_PAUSE_S = 0.25  # with opening and configuring, still under 2 s after the device is there
POLL_S = 0.1


def _nothing() -> None: ...


class SonarLife(threading.Thread):
    """Serves one sonar as long as it is not stopped, whatever the sonar does.

    Hardware that is missing is waited for, hardware that fails is opened again. Anything else that
    fails (an unknown address, a model that does not fit, a damaged recording) ends this sonar's
    service, and only this one's.

    Parameters
    ----------
    config
        Of this sonar.
    outputs
        Stay open from one opening to the next; closed at the end.
    turns
        Shared with the sonars that it takes turns with; None for none.
    can_command
        Whether commands may come, so that pings are kept for a recording.
    beat
        Feeds the watchdog.
    around
        Added to each status message.
    subscribe
        Hears a key of others through a channel of some size, for odometry.
    backoff
        How long it is left alone after trouble.

    Attributes
    ----------
    status : Status
        Since the daemon began.
    error : Exception or None
        What ended it for good.
    is_settled : bool
        The first try to open it is over.
    """

    def __init__(
        self,
        config: SonarConfig,
        outputs: Sequence[Output],
        *,
        turns: Turns | None = None,
        can_command: bool = False,
        beat: Callable[[], None] = _nothing,
        around: Callable[[], Mapping[str, Any]] = dict,
        subscribe: Callable[[str, int], Any] | None = None,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__(name=f"sonar {config.device.name}", daemon=True)
        self.config = config
        self.status = Status(device=config.device.name)
        self.requests = PingRequests()
        self.recorder = self._new_recorder(config, can_command=can_command)
        self.error: Exception | None = None
        self.is_settled = self._is_over = False
        self._can_command = can_command
        self._turns = turns
        self._beat = beat
        self._subscribe = subscribe
        self._publisher = FanOut(outputs, self.status)
        self._reporter = Reporter(self.status, self._publisher, around)
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._next: tuple[SonarConfig, Turns | None] | None = None
        self._run_stop = threading.Event()
        self._backoff = backoff or Backoff()
        self._opened_s = math.inf  # not this time
        self._heard_before = 0  # since the daemon began, when this configuration was taken
        self._checked: SonarConfig | None = None
        self._detector: LandmarkDetector | None = None  # of what was checked

    @property
    def is_over(self) -> bool:
        """Whether it will not be opened again: it has ended, and nobody has configured it anew."""
        return self._is_over and self._next is None

    def run(self) -> None:
        """Serve until stopped."""
        try:
            while not self._ended.is_set():
                self._live_once()
        finally:
            self.recorder.close()
            self._reporter.publish()
            self._publisher.close()

    def stop(self) -> None:
        """Ask it to end; ``join`` waits for that."""
        self._ended.set()
        with self._lock:
            self._run_stop.set()

    def reconfigure(self, config: SonarConfig, turns: Turns | None) -> None:
        """Close the sonar and open it as this says; name and publisher stay."""
        with self._lock:
            self._next = (config, turns)
            self._run_stop.set()

    def _live_once(self) -> None:
        with self._lock:
            if self._next is not None:
                self._adopt(*self._next)
                self._next = None
            self._run_stop = stop = threading.Event()
        if self._ended.is_set():
            return
        self._opened_s = math.inf
        try:
            self._serve(stop)
        except ABSENT as error:
            self._backoff.reset()
            self._wait(stop, "waiting", error, ABSENT_PAUSE_S)
        except TROUBLED as error:
            if not is_hardware(self.config.device.address):
                self._over("failed", stop, error)
                return
            last_heard_s = self.status.heard_s[-1] if self.status.heard_s else -math.inf
            worked_s = max(0.0, last_heard_s - self._opened_s)
            self._wait(stop, "failed", error, self._backoff.after(worked_s))
        except Exception as error:  # noqa: BLE001  # of this sonar only
            self._over("failed", stop, error)
        else:
            if not stop.is_set():
                self._over("ended", stop, None)

    def _adopt(self, config: SonarConfig, turns: Turns | None) -> None:
        if config.record != self.config.record:
            self.recorder.close()
            self.recorder = self._new_recorder(config, can_command=self._can_command)
        self.config, self._turns = config, turns
        self._heard_before = self.status.pings_heard
        self.error, self._is_over = None, False

    def _new_recorder(self, config: SonarConfig, *, can_command: bool) -> Recorder:
        keeps_ring = can_command or bool(config.record.on)
        return Recorder(config.record, config.device.name, self.status, keeps_ring=keeps_ring)

    def _serve(self, stop: threading.Event) -> None:
        config = self.config
        heard = self.status.pings_heard - self._heard_before
        if 0 < config.max_pings <= heard:
            return
        if self._checked is not config:
            # Now: a wrong model is said at once, not when the device is there; and it is read once.
            self._detector = load_detector(config)
            self._checked = config
        if self.status.state not in ("waiting", "failed"):
            self.status.state = "starting"
        with ExitStack() as stack:
            sonar = stack.enter_context(open_device(config.device.address, reconnect=True))
            sonar.configure(config.settings())
            self._beat()
            settings = sonar.settings or config.settings()  # a recording keeps its own
            detector = self._detector if settings == config.settings() else None
            pipeline = build_pipeline(config, settings, self._odometry(config, stack), detector)
            self._opened(sonar, settings, pipeline)
            pace = Pace(
                config.ping_on,
                config.ping_rate_hz,
                config.max_pings and config.max_pings - heard,
                self._turns,
                self.requests,
            )
            Service(
                sonar,
                pipeline,
                self._publisher,
                config,
                stop,
                status=self.status,
                pace=pace,
                recorder=self.recorder,
                beat=self._beat,
                reporter=self._reporter,
            ).run()

    def _odometry(self, config: SonarConfig, stack: ExitStack) -> Odometry | None:
        if not config.odometry.key or self._subscribe is None:
            return None
        odometry = Odometry(config.odometry, config.pose)
        subscriber = self._subscribe(config.odometry.key, POSES_WAITING)
        stack.callback(subscriber.undeclare)
        odometry.listen(subscriber)
        return odometry

    def _opened(self, sonar: Sonar, settings: Settings, pipeline: Pipeline) -> None:
        config, info = self.config, sonar.info
        self._publisher.describe(sonar_info(config, info, settings, pipeline), config.to_json())
        self.recorder.begin(
            RecordingInfo(
                source=info.source,
                chirp=settings.chirp,
                num_words=settings.num_words,
                temperature_c=config.temperature_c,
                humidity_percent=config.humidity_percent,
                firmware=info.firmware,
                address=info.address,
                pdm_rate_hz=settings.pdm_rate_hz,
            )
        )
        self._opened_s = time.monotonic()
        self.status.starts += 1
        self.status.state, self.status.reason = "running", ""
        self.is_settled = True
        log.info("%s: %s is open", config.device.name, info.address)

    def _wait(self, stop: threading.Event, state: State, error: Exception, pause_s: float) -> None:
        """Pause before the next try; the reason is logged once."""
        reason = f"{type(error).__name__}: {error}"
        if (state, reason) != (self.status.state, self.status.reason):
            log.warning("%s: %s; tried again and again", self.config.device.name, error)
        self.status.state, self.status.reason = state, reason
        self.is_settled = True
        self._linger(stop, time.monotonic() + pause_s)

    def _over(self, state: State, stop: threading.Event, error: Exception | None) -> None:
        """Publish the status on, until it is stopped or configured anew."""
        self.status.state = state
        self.status.reason = f"{type(error).__name__}: {error}" if error else ""
        if error is not None:
            log.error("%s: %s", self.config.device.name, error)
        self.error = error
        self.is_settled = self._is_over = True
        self._linger(stop, float("inf"))

    def _linger(self, stop: threading.Event, until_s: float) -> None:
        while not stop.is_set() and not self._ended.is_set() and time.monotonic() < until_s:
            self._reporter.tick()
            self._beat()
            stop.wait(min(POLL_S, max(0.0, until_s - time.monotonic())))
