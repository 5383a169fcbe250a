"""One sonar's events and status as ROS 2 messages. Implements the service's ``Publisher``."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, Protocol

from ertis_daemon.events import LandmarkEvent
from ertis_daemon.ros2 import convert, geometry, messages
from ertis_daemon.ros2.config import ros_name
from ertis_daemon.ros2.docking import DockChooser
from ertis_daemon.ros2.node import RosNode, RosPublisher
from ertis_daemon.ros2.wire import Qos

LATEST_10 = Qos(10)  # the default of ROS publishers
LATCHED = Qos(1, transient_local=True)  # what /tf_static is


class Mounting(Protocol):
    """Where a sonar sits on the robot: position in m, turns about the fixed x, y, z axes."""

    parent_frame: str
    x_m: float
    y_m: float
    z_m: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float


class Ros2Publisher:
    """Publishes one sonar on a node that may have several.

    Parameters
    ----------
    node
        Entered already; who made it closes it.
    device_name, frame_id
        As in events.
    hardware_id
        Address or serial number, told in diagnostics.
    mounting
        If it names a parent frame, the transform from it to ``frame_id`` goes to ``/tf_static``.
    """

    def __init__(
        self,
        node: RosNode,
        device_name: str,
        *,
        frame_id: str,
        hardware_id: str,
        mounting: Mounting | None = None,
    ) -> None:
        config = node.config
        self._stack = ExitStack()

        def publisher(kind: str, topic: str, qos: Qos) -> RosPublisher:
            made = node.publisher(kind, topic, qos)
            self._stack.callback(made.close)
            return made

        topic = config.detections_topic or f"{ros_name(device_name)}/detections"
        self._detections = publisher(messages.DETECTIONS, topic, LATEST_10)
        self._diagnosis = convert.Diagnosis(device_name, hardware_id)
        self._diagnostics: RosPublisher | None = None
        if config.diagnostics_topic:
            self._diagnostics = publisher(messages.DIAGNOSTICS, config.diagnostics_topic, LATEST_10)
        self._chooser: DockChooser | None = None
        if config.dock_class and config.dock_sonar in ("", device_name):
            self._chooser = DockChooser(config.dock_class, config.dock_min_probability)
            self._dock = publisher(messages.POSE, config.dock_topic, LATEST_10)
        if mounting is not None and mounting.parent_frame:
            self._transform = publisher(messages.TRANSFORMS, "/tf_static", LATCHED)
            self._transform.put(static_transform(mounting, frame_id, time.time_ns()))

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event, and where the dock is if the event tells."""
        self._detections.put(convert.detections(event))
        if self._chooser is not None:
            dock = self._chooser.choose(event, time.time_ns())
            if dock is not None:
                self._dock.put(convert.dock_pose(event, dock))

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the service's counters."""
        if self._diagnostics is not None:
            self._diagnostics.put(self._diagnosis.message(status, time.time_ns()))

    def close(self) -> None:
        """Take this sonar's topics off the network; the node stays. May be called twice."""
        self._stack.close()


def static_transform(mounting: Mounting, frame_id: str, time_ns: int) -> Any:
    """Return where a sonar sits, as a ``TFMessage`` of one transform."""
    angles = (mounting.roll_deg, mounting.pitch_deg, mounting.yaw_deg)
    transform = messages.new(
        "geometry_msgs/msg/Transform",
        translation=messages.vector((mounting.x_m, mounting.y_m, mounting.z_m)),
        rotation=messages.quaternion(geometry.from_euler(*map(math.radians, angles))),
    )
    stamped = messages.new(
        "geometry_msgs/msg/TransformStamped",
        header=messages.header(time_ns, mounting.parent_frame),
        child_frame_id=frame_id,
        transform=transform,
    )
    return messages.new(messages.TRANSFORMS, transforms=[stamped])
