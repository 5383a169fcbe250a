"""ROS messages as bytes (CDR): made and hashed by ``rosbags``, which brings ROS's own definitions.

The definitions of ``vision_msgs`` are not among them, so their fields stand here. A wrong field
would show at once: the hash made from it would not be the one that ROS publishes.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ertis_daemon.ros2.wire import MessageKind

Floats = Sequence[float] | npt.NDArray[np.float64]

DETECTIONS = "vision_msgs/msg/Detection3DArray"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
POSE = "geometry_msgs/msg/PoseStamped"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

# Source: ros-perception/vision_msgs 4, field by field.
_VISION_FIELDS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\n"
        "vision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\n"
        "string id"
    ),
    DETECTIONS: "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}


@functools.cache
def _store() -> Any:
    # Jazzy's: these messages are the same from Iron to Lyrical.
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for name, fields in _VISION_FIELDS.items():
        types |= get_types_from_msg(fields, name)
    store.register(types)
    return store


def kind(name: str) -> MessageKind:
    """Return a message type, given its ROS name."""
    return MessageKind(name, _store().hash_rihs01(name))


def encode(message: Any) -> bytes:
    """Return a message as CDR, little-endian, behind its four bytes of header."""
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def new(kind_name: str, /, **fields: Any) -> Any:
    """Return a message of a ROS type, every field given.

    Raises
    ------
    TypeError
        If a field is missing or unknown.
    """
    return _store().types[kind_name](**fields)


def header(time_ns: int, frame_id: str) -> Any:
    """Return a ``std_msgs/Header``; the time is UNIX time, in ns."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    stamp = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def point(xyz_m: Floats) -> Any:
    """Return a ``geometry_msgs/Point``."""
    x, y, z = map(float, xyz_m)
    return new("geometry_msgs/msg/Point", x=x, y=y, z=z)


def vector(xyz_m: Floats) -> Any:
    """Return a ``geometry_msgs/Vector3``."""
    x, y, z = map(float, xyz_m)
    return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def quaternion(xyzw: Floats) -> Any:
    """Return a ``geometry_msgs/Quaternion``."""
    x, y, z, w = map(float, xyzw)
    return new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def pose(xyz_m: Floats, xyzw: Floats) -> Any:
    """Return a ``geometry_msgs/Pose``."""
    return new("geometry_msgs/msg/Pose", position=point(xyz_m), orientation=quaternion(xyzw))


def definition(name: str) -> str:
    """Return the definition of a ROS type and of all that it is made of, as bags hold it."""
    text: str = _store().generate_msgdef(name, ros_version=2)[0]
    return text
