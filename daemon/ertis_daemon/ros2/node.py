"""A ROS node: its session, its token, and publishers that ROS sees and hears."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

import zenoh
from typing_extensions import Self
from zenoh import ext

from ertis_daemon.ros2 import environment, messages, wire
from ertis_daemon.ros2.config import Ros2Config
from ertis_daemon.zenoh_session import close_session, open_session
from ertis_driver.closing import Closing

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.5  # the last message of a burst, if lost, is recovered after this


class RosNode(Closing):
    """One node for all sonars, on a Zenoh session of its own. A context manager.

    Its session is not that of the other publishers, so that it can be another network: ROS users
    set it in the environment.

    Parameters
    ----------
    config
        Names and domain.
    session
        How to open the session, if the environment does not say otherwise.
    environ
        The environment.

    Raises
    ------
    PublisherError
        On entering, if the environment or Zenoh refuses.
    """

    def __init__(
        self, config: Ros2Config, session: zenoh.Config, environ: Mapping[str, str] = os.environ
    ) -> None:
        self.config = config
        self._domain_id = environment.domain_id(config.domain_id, environ)
        self._session_config = environment.session_config(session, environ)
        self._entities = 0
        self._publishers: list[RosPublisher] = []
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        session = open_session(self._session_config)
        with ExitStack() as stack:
            stack.callback(close_session, session)
            self._session = session
            self._node = wire.Node(
                domain_id=self._domain_id,
                zenoh_id=str(session.zid()),
                node_id=0,
                namespace=self.config.namespace,
                name=self.config.node,
            )
            self._token = session.liveliness().declare_token(self._node.token)
            self._stack = stack.pop_all()
        name = wire.absolute_name(self.config.namespace, self.config.node)
        log.info("ROS 2: node %s in domain %d", name, self._domain_id)
        return self

    def publisher(self, kind: str, topic: str, qos: wire.Qos) -> RosPublisher:
        """Make a publisher of messages of the ROS type ``kind``."""
        self._entities += 1
        message_kind = messages.kind(kind)
        absolute = wire.absolute_name(self.config.namespace, topic)
        token = self._node.publisher_token(self._entities, absolute, message_kind, qos)
        key = self._node.data_key(absolute, message_kind)
        made = RosPublisher(self._session, key, token, qos)
        self._publishers.append(made)  # Zenoh takes back what nobody holds
        return made

    def close(self) -> None:
        """Leave the network, in bounded time. May be called twice."""
        self._stack.close()


class RosPublisher:
    """One topic. Made by ``RosNode.publisher``, and gone with the node at the latest."""

    def __init__(self, session: zenoh.Session, key: str, token: str, qos: wire.Qos) -> None:
        self._gid = wire.gid(token)
        self._sequence = 0
        self._closed = False
        self._publisher: Any = ext.declare_advanced_publisher(
            session,
            key,
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=zenoh.Reliability.RELIABLE,
            cache=ext.CacheConfig(max_samples=qos.depth),
            sample_miss_detection=ext.MissDetectionConfig(
                heartbeat=None, sporadic_heartbeat=HEARTBEAT_S
            ),
            publisher_detection=True,
        )
        # After the publisher: whoever sees the token may count on it.
        self._token: Any = session.liveliness().declare_token(token)

    def close(self) -> None:
        """Take the topic off the network. May be called twice."""
        if not self._closed:
            self._closed = True
            self._token.undeclare()
            self._publisher.undeclare()

    def put(self, message: Any) -> None:
        """Publish a message."""
        self._sequence += 1
        attachment = wire.attachment(self._sequence, time.time_ns(), self._gid)
        self._publisher.put(messages.encode(message), attachment=attachment)
