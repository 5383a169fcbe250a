"""Events, status and raw frames of one sonar over Zenoh. Keys and qualities are in EVENTS.md."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

import zenoh
from zenoh import ext

from ertis_daemon.events import ENCODING, LandmarkEvent, dump_json, json_schema
from ertis_daemon.queries import JSON, Answers, Obey
from ertis_driver.closing import Closing
from ertis_driver.frame import PdmFrame
from ertis_driver.protocol import encode_frame

log = logging.getLogger(__name__)

EVENT_CACHE = 32  # a late joiner sees at least the last second at 30 pings a second
HEARTBEAT_S = 0.5  # the last event of a burst, if lost, is recovered after this
RAW_ENCODING = "application/octet-stream;ertis.frame/1"


class ZenohPublisher(Closing):
    """Publishes what one sonar hears and answers queries about it, as long as it is not closed.

    Parameters
    ----------
    session
        Open; it outlives the publisher.
    device_name
        Chunk of the keys ``ertis/<device_name>/...``.
    info, effective_config
        What the ``info`` and ``config`` keys answer, as JSON.
    raw
        Offer whole frames.
    obey
        Does what ``cmd/...`` asks for; None if nothing does.
    """

    name = "Zenoh"

    def __init__(
        self,
        session: zenoh.Session,
        device_name: str,
        *,
        info: Mapping[str, Any],
        effective_config: Mapping[str, Any],
        raw: bool = False,
        obey: Obey | None = None,
    ) -> None:
        self._base = base = f"ertis/{device_name}"
        with ExitStack() as stack:
            self._landmarks = stack.enter_context(_declare_landmarks(session, base))
            self._status = stack.enter_context(_declare_status(session, base))
            self._raw = stack.enter_context(_declare_raw(session, base)) if raw else None
            names = ("last", "config", "schema", "info", "status")
            self._answers = stack.enter_context(Answers(session, base, names))
            if obey is not None:
                # In a thread of its own: a reload takes seconds, and nobody else waits for it.
                stack.enter_context(Answers(session, base, (), obey))
            self._answers.set("schema", dump_json(json_schema()), "application/schema+json")
            self.describe(info, effective_config)
            token = session.liveliness().declare_token(f"{base}/alive")
            stack.callback(token.undeclare)
            self._stack = stack.pop_all()
        log.info("publishing on %s/landmarks", base)

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Answer queries for ``info`` and ``config`` with these from now on."""
        self._answers.set("info", dump_json(info))
        self._answers.set("config", dump_json(effective_config))

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event; it is also what ``last`` answers from now on."""
        data = event.to_json()
        self._answers.set("last", data, ENCODING)
        self._landmarks.put(data)

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the service's counters; also what a query for ``status`` answers."""
        data = dump_json(status)
        self._answers.set("status", data)
        self._status.put(data)

    def publish_raw(self, frame: PdmFrame) -> None:
        """Publish a whole frame, if it is offered and somebody listens."""
        if self._raw is None or not self._raw.matching_status.matching:
            return
        about = {
            "ping_index": frame.ping_index,
            "ping_time_ns": frame.ping_time_ns,
            "time_uncertainty_ns": frame.time_uncertainty_ns,
            "active": frame.active,
            "pdm_rate_hz": frame.pdm_rate_hz,
            "clock_step_ns": frame.clock_step_ns,
        }
        self._raw.put(encode_frame(frame.ping_index, frame.words), attachment=dump_json(about))

    def close(self) -> None:
        """Publish no more; the session stays open. May be called twice."""
        try:
            self._stack.close()
        except zenoh.ZError as error:  # the session was closed before
            log.debug("%s: %s", self._base, error)


def _declare_landmarks(session: zenoh.Session, base: str) -> ext.AdvancedPublisher:
    return ext.declare_advanced_publisher(
        session,
        f"{base}/landmarks",
        encoding=ENCODING,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.INTERACTIVE_HIGH,
        express=True,
        cache=ext.CacheConfig(max_samples=EVENT_CACHE),
        sample_miss_detection=ext.MissDetectionConfig(
            heartbeat=None, sporadic_heartbeat=HEARTBEAT_S
        ),
        publisher_detection=True,
    )


def _declare_status(session: zenoh.Session, base: str) -> ext.AdvancedPublisher:
    return ext.declare_advanced_publisher(
        session,
        f"{base}/status",
        encoding=JSON,
        congestion_control=zenoh.CongestionControl.DROP,
        cache=ext.CacheConfig(max_samples=1),
        publisher_detection=True,
    )


def _declare_raw(session: zenoh.Session, base: str) -> zenoh.Publisher:
    return session.declare_publisher(
        f"{base}/raw",
        encoding=RAW_ENCODING,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.BACKGROUND,
    )
