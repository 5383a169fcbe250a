"""Events and status over Zenoh. Keys and quality of service are in EVENTS.md."""

from __future__ import annotations

import json
import logging
import re
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

import zenoh
from typing_extensions import Self
from zenoh import ext

from ertis_daemon.config import ZenohConfig
from ertis_daemon.events import ENCODING, LandmarkEvent, dump_json, json_schema
from ertis_driver.closing import Closing
from ertis_driver.errors import ErtisError

log = logging.getLogger(__name__)

EVENT_CACHE = 32  # a late joiner sees at least the last second at 30 pings a second
HEARTBEAT_S = 0.5  # the last event of a burst, if lost, is recovered after this
QUERY_POLL_S = 0.02  # what a query waits for at most
QUERIES_WAITING = 16  # of each kind; the oldest is dropped and ends empty
CLOSE_S = 2.0  # Zenoh's own close has been seen to hang
JSON = "application/json"


class PublisherError(ErtisError):
    """Zenoh refuses the configured locators: correct them, or end who holds the port."""


def session_config(
    mode: str, connect: tuple[str, ...] | list[str], listen: tuple[str, ...] | list[str]
) -> zenoh.Config:
    """Describe a session as rmw_zenoh makes it: no multicast, time stamps, no shared memory.

    Raises
    ------
    PublisherError
        If a value is not understood.
    """
    values = {
        "mode": mode,
        "connect/endpoints": list(connect),
        "listen/endpoints": [] if mode == "client" else list(listen),
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,  # an AdvancedPublisher needs it
        "transport/shared_memory/enabled": False,  # zenoh#2628, zenoh#2787
    }
    config: zenoh.Config = zenoh.Config()
    try:
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise PublisherError(f"Zenoh: {_one_line(error)}") from error
    return config


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session; a peer does so with nobody to connect to, and keeps trying.

    Raises
    ------
    PublisherError
        If a locator is wrong, a port taken, or a client finds no router.
    """
    try:
        session: zenoh.Session = zenoh.open(config)
    except zenoh.ZError as error:
        raise PublisherError(f"Zenoh: {_one_line(error)}") from error
    return session


def close_session(session: zenoh.Session) -> None:
    """Close a session, in bounded time (zenoh#2675)."""
    closer = threading.Thread(target=session.close, name="zenoh-close", daemon=True)
    closer.start()
    closer.join(CLOSE_S)
    if closer.is_alive():
        log.warning("Zenoh did not close within %g s, left to the end of the process", CLOSE_S)


def _one_line(error: Exception) -> str:
    """Zenoh's message without the places in its own source."""
    return " ".join(re.sub(r"\.?\s+at /\S+\.rs:\d+\.?", "", str(error)).split())


class ZenohPublisher(Closing):
    """Publishes the events of one sonar and answers queries about it. A context manager.

    Parameters
    ----------
    device_name
        Chunk of the keys ``ertis/<device_name>/...``.
    config
        How to reach the network.
    info, effective_config
        What the ``info`` and ``config`` keys answer, as JSON.

    Raises
    ------
    PublisherError
        On entering, if Zenoh refuses a locator or a port is taken.
    """

    def __init__(
        self,
        device_name: str,
        config: ZenohConfig,
        *,
        info: Mapping[str, Any],
        effective_config: Mapping[str, Any],
    ) -> None:
        self._base = f"ertis/{device_name}"
        self._config = config
        self._answers: dict[str, tuple[bytes, str]] = {  # replaced whole: no lock needed
            "info": (dump_json(info), JSON),
            "config": (dump_json(effective_config), JSON),
            "schema": (dump_json(json_schema()), "application/schema+json"),
        }
        self._done = threading.Event()
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        session = open_session(
            session_config(self._config.mode, self._config.connect, self._config.listen)
        )
        with ExitStack() as stack:
            stack.callback(close_session, session)
            self._declare(session)
            self._session = session
            stack.callback(self._stop_answering)
            self._stack = stack.pop_all()
        log.info("publishing on %s/landmarks", self._base)
        return self

    def _declare(self, session: zenoh.Session) -> None:
        base = self._base
        self._landmarks = ext.declare_advanced_publisher(
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
        self._status = ext.declare_advanced_publisher(
            session,
            f"{base}/status",
            encoding=JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            cache=ext.CacheConfig(max_samples=1),
            publisher_detection=True,
        )
        self._queryables = {
            name: session.declare_queryable(
                f"{base}/{name}", zenoh.handlers.RingChannel(QUERIES_WAITING)
            )
            for name in ("last", "config", "schema", "info", "status")
        }
        self._alive = session.liveliness().declare_token(f"{base}/alive")
        self._answerer = threading.Thread(target=self._answer, name="queries", daemon=True)
        self._answerer.start()

    def subscribe(self, key: str, waiting: int) -> zenoh.Subscriber[Any]:
        """Hear what others publish; the newest samples wait in a channel, the oldest are dropped.

        Raises
        ------
        PublisherError
            If the key is none.
        """
        try:
            return self._session.declare_subscriber(key, zenoh.handlers.RingChannel(waiting))
        except zenoh.ZError as error:
            raise PublisherError(f"Zenoh: key {key!r}: {_one_line(error)}") from error

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event; it is also what ``last`` answers from now on."""
        data = event.to_json()
        self._answers["last"] = (data, ENCODING)
        self._landmarks.put(data)

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the service's counters; also what a query for ``status`` answers."""
        data = dump_json(status)
        self._answers["status"] = (data, JSON)
        self._status.put(data)

    def close(self) -> None:
        """Leave the network, in bounded time. May be called twice."""
        self._stack.close()

    def _stop_answering(self) -> None:
        self._done.set()
        self._answerer.join(CLOSE_S)

    def _answer(self) -> None:
        while not self._done.wait(QUERY_POLL_S):
            for name, queryable in self._queryables.items():
                try:
                    while (query := queryable.try_recv()) is not None:
                        self._reply(name, query)
                except zenoh.ZError as error:
                    log.warning("a query for %s went unanswered: %s", name, _one_line(error))

    def _reply(self, name: str, query: zenoh.Query) -> None:
        with query:  # dropped at the end, so that the asker's get ends
            answer = self._answers.get(name)
            if answer is not None:
                query.reply(f"{self._base}/{name}", answer[0], encoding=answer[1])
