"""Where events, status and frames of one sonar go."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ertis_daemon.events import LandmarkEvent
from ertis_daemon.status import Status
from ertis_daemon.zenoh_session import one_line
from ertis_driver.closing import Closing
from ertis_driver.errors import ErtisError
from ertis_driver.frame import PdmFrame

log = logging.getLogger(__name__)

SAID_AGAIN_S = 60.0  # of a way out that fails now and then


class Publisher(Protocol):
    """Where a sonar's service sends what it has to tell."""

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Take who publishes, and how it is configured; again after each change."""

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event."""

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the counters."""

    def publish_raw(self, frame: PdmFrame) -> None:
        """Publish a whole frame, if that is wanted."""

    def close(self) -> None:
        """Leave. May be called twice."""


class Output(Publisher, Protocol):
    """One way out."""

    @property
    def name(self) -> str:
        """What people call it."""


class NoWayOut(ErtisError):
    """An event went out nowhere: look at what the status says of each output."""


class FanOut(Closing):
    """Several ways out as one. What fails on one still goes out on the others.

    A way that fails costs nothing but what it did not send: its first failure is logged, all are
    counted, and the status names it until it works again.

    Parameters
    ----------
    outputs
        Used in this order.
    status
        ``publish_failures`` is counted and ``outputs_failing`` kept here.
    """

    def __init__(self, outputs: Sequence[Output], status: Status) -> None:
        self._outputs = tuple(outputs)
        self._status = status
        self._said_s: dict[str, float] = {}

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Tell each."""
        self._each("description", lambda one: one.describe(info, effective_config))

    def publish(self, event: LandmarkEvent) -> None:
        """Publish on each.

        Raises
        ------
        NoWayOut
            If none of them took it.
        """
        if not self._each("events", lambda one: one.publish(event)):
            raise NoWayOut(f"ping {event.ping_index}: no output took its event")

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish on each."""
        self._each("status", lambda one: one.publish_status(status))

    def publish_raw(self, frame: PdmFrame) -> None:
        """Publish on each."""
        self._each("frames", lambda one: one.publish_raw(frame))

    def close(self) -> None:
        """Leave all."""
        self._each("end", lambda one: one.close())

    def _each(self, what: str, do: Callable[[Output], None]) -> int:
        """How many could do it."""
        done = 0
        for one in self._outputs:
            way = f"{one.name} {what}"
            try:
                do(one)
            except Exception as error:  # noqa: BLE001  # told, and counted, there
                self._failed(way, error)
            else:
                done += 1
                self._works(way)
        return done

    def _failed(self, way: str, error: Exception) -> None:
        status, reason = self._status, f"{type(error).__name__}: {one_line(error)}"
        status.publish_failures += 1
        if way in status.outputs_failing:
            return
        status.outputs_failing = {**status.outputs_failing, way: reason}  # others read it
        now_s = time.monotonic()
        if now_s - self._said_s.get(way, -SAID_AGAIN_S) >= SAID_AGAIN_S:
            self._said_s[way] = now_s
            log.error("%s: %s cannot be published: counted", status.device, way, exc_info=error)

    def _works(self, way: str) -> None:
        failing = self._status.outputs_failing
        if way in failing:
            self._status.outputs_failing = {k: v for k, v in failing.items() if k != way}
            log.info("%s: %s are published again", self._status.device, way)
