"""The Zenoh session that all sonars of the daemon share."""

from __future__ import annotations

import json
import logging
import re
import threading
from collections.abc import Sequence
from typing import Any

import zenoh
from typing_extensions import Self

from ertis_daemon.config import ZenohConfig
from ertis_daemon.tls import tls_values
from ertis_driver.closing import Closing
from ertis_driver.errors import ErtisError

log = logging.getLogger(__name__)

CLOSE_S = 1.5  # Zenoh's own close has been seen to hang
RETRY_MS = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}


class PublisherError(ErtisError):
    """Zenoh refuses the configured locators: correct them, or end who holds the port."""


def session_config(
    mode: str,
    connect: tuple[str, ...] | list[str],
    listen: tuple[str, ...] | list[str],
    tls: str = "",
) -> zenoh.Config:
    """Describe a session as rmw_zenoh makes it: no multicast, time stamps, no shared memory.

    ``tls`` is the folder of the certificate, for a router that asks for one.

    Raises
    ------
    PublisherError
        If a value is not understood.
    TlsError
        If the certificate cannot be used.
    """
    values: dict[str, Any] = {
        "mode": mode,
        "connect/endpoints": list(connect),
        "connect/retry": RETRY_MS,
        "listen/endpoints": [] if mode == "client" else list(listen),
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,  # an AdvancedPublisher needs it
        "transport/shared_memory/enabled": False,  # zenoh#2628, zenoh#2787
    }
    if tls:
        values["transport/link/tls"] = tls_values(tls, mode, connect)
    config: zenoh.Config = zenoh.Config()
    try:
        for key, value in values.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise PublisherError(f"Zenoh: {one_line(error)}") from error
    return config


def any_port(listen: Sequence[str]) -> tuple[str, ...]:
    """The same addresses with a port that is free, for another session beside the first."""
    anywhere = (re.sub(r":\d+(?=$|[?#])", ":0", locator) for locator in listen)
    return tuple(locator for locator in anywhere if re.search(r":0($|[?#])", locator))


def open_session(config: zenoh.Config) -> zenoh.Session:
    """Open a session; a peer does so with nobody to connect to, and keeps trying.

    Zenoh's own log goes to stderr if RUST_LOG says what of it.

    Raises
    ------
    PublisherError
        If a locator is wrong, a port taken, or a client finds no router.
    """
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
    try:
        session: zenoh.Session = zenoh.open(config)
    except zenoh.ZError as error:
        raise PublisherError(f"Zenoh: {one_line(error)}") from error
    return session


def close_session(session: zenoh.Session) -> None:
    """Close a session, in bounded time (zenoh#2675)."""
    closer = threading.Thread(target=session.close, name="zenoh-close", daemon=True)
    closer.start()
    closer.join(CLOSE_S)
    if closer.is_alive():
        log.warning("Zenoh did not close within %g s, left to the end of the process", CLOSE_S)


def one_line(error: Exception) -> str:
    """Zenoh's message without the places in its own source."""
    return " ".join(re.sub(r"\.?\s+at /\S+\.rs:\d+\.?", "", str(error)).split())


class Network(Closing):
    """A session, opened and closed in bounded time.

    Raises
    ------
    PublisherError
        If Zenoh refuses a locator or a port is taken.
    """

    def __init__(self, config: ZenohConfig) -> None:
        described = session_config(config.mode, config.connect, config.listen, config.tls)
        self.session = open_session(described)
        self._closed = False

    def routers(self) -> int:
        """How many routers the session is connected to now."""
        return len(self.session.info.routers_zid())

    def peers(self) -> int:
        """How many peers the session is connected to now."""
        return len(self.session.info.peers_zid())

    def subscribe(self, key: str, waiting: int) -> zenoh.Subscriber[Any]:
        """Hear what others publish; the newest samples wait in a channel, the oldest are dropped.

        Raises
        ------
        PublisherError
            If the key is none.
        """
        try:
            return self.session.declare_subscriber(key, zenoh.handlers.RingChannel(waiting))
        except zenoh.ZError as error:
            raise PublisherError(f"Zenoh: key {key!r}: {one_line(error)}") from error

    def close(self) -> None:
        """Leave the network. May be called twice."""
        if not self._closed:
            self._closed = True
            close_session(self.session)

    def __enter__(self) -> Self:
        """Nothing but itself: it is open already."""
        return self
