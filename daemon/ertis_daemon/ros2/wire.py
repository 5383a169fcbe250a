"""How rmw_zenoh names things: keys, liveliness tokens, quality of service, attachments.

Source: ros2/rmw_zenoh, docs/design.md, and what its ``liveliness_utils``, ``qos`` and
``attachment_helpers`` make. Strings and bytes only; nothing here knows a session.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import xxhash

GID_BYTES = 16
_ENCLAVE = "%"  # the default security enclave


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a publisher: reliable, and the last ``depth`` messages are kept.

    transient_local : bool
        Late joiners get what is kept; ROS calls this "latched".
    """

    depth: int = 10
    transient_local: bool = False

    @property
    def encoded(self) -> str:
        """As it stands in a token; what equals rmw_zenoh's defaults is left out.

        >>> Qos(10).encoded, Qos(5, transient_local=True).encoded
        ('::,10:,:,:,,', ':1:,5:,:,:,,')
        """
        return f":{1 if self.transient_local else ''}:,{self.depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class Node:
    """A ROS node on a Zenoh session.

    zenoh_id : str
        Of the session, as hexadecimal text.
    node_id : int
        Unique in the session; entities of the node count on from there.
    namespace : str
        ``/`` or an absolute name.
    """

    domain_id: int
    zenoh_id: str
    node_id: int
    namespace: str
    name: str

    @property
    def token(self) -> str:
        """Liveliness key that makes the node visible."""
        parts = (self._start(self.node_id), "NN", _ENCLAVE, _mangled(self.namespace), self.name)
        return "/".join(parts)

    def publisher_token(self, entity_id: int, topic: str, kind: MessageKind, qos: Qos) -> str:
        """Liveliness key that makes a publisher of the node visible; ``topic`` is absolute."""
        return "/".join(
            (
                self._start(entity_id),
                *("MP", _ENCLAVE, _mangled(self.namespace), self.name),
                *(_mangled(topic), kind.dds_name, kind.type_hash, qos.encoded),
            )
        )

    def data_key(self, topic: str, kind: MessageKind) -> str:
        """Key that the messages of an absolute topic are put under."""
        return f"{self.domain_id}/{topic.strip('/')}/{kind.dds_name}/{kind.type_hash}"

    def _start(self, entity_id: int) -> str:
        return f"@ros2_lv/{self.domain_id}/{self.zenoh_id}/{self.node_id}/{entity_id}"


@dataclass(frozen=True, slots=True)
class MessageKind:
    """A message type: its ROS name (``package/msg/Name``) and its hash, ``RIHS01_...``."""

    name: str
    type_hash: str

    @property
    def dds_name(self) -> str:
        """The name that DDS would know it by.

        >>> MessageKind("std_msgs/msg/String", "RIHS01_0").dds_name
        'std_msgs::msg::dds_::String_'
        """
        package, folder, name = self.name.split("/")
        return f"{package}::{folder}::dds_::{name}_"


def absolute_name(namespace: str, topic: str) -> str:
    """Resolve a topic as ROS does: relative to the namespace unless it starts with a slash.

    >>> absolute_name("/robot1", "dish"), absolute_name("/", "dish"), absolute_name("/a", "/tf")
    ('/robot1/dish', '/dish', '/tf')
    """
    return topic if topic.startswith("/") else f"{namespace.rstrip('/')}/{topic}"


def gid(token: str) -> bytes:
    """Name of a publisher in its messages: XXH3-128 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(GID_BYTES, "little")


def attachment(sequence: int, source_time_ns: int, publisher_gid: bytes) -> bytes:
    """What rmw_zenoh wants beside each message, 33 bytes: without it the message is dropped."""
    return struct.pack("<qqB", sequence, source_time_ns, GID_BYTES) + publisher_gid


def _mangled(name: str) -> str:
    """Name as one chunk of a key."""
    return name.replace("/", "%")
