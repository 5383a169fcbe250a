"""One sonar's events and status as ROS 2 messages. Implements the service's ``Publisher``."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any

from ertis_daemon.events import LandmarkEvent
from ertis_daemon.ros2 import convert, messages
from ertis_daemon.ros2.config import ros_name
from ertis_daemon.ros2.docking import DockChooser
from ertis_daemon.ros2.node import RosNode, RosPublisher
from ertis_daemon.ros2.wire import Qos
from ertis_driver.frame import PdmFrame

LATEST_10 = Qos(10)  # the default of ROS publishers
SELDOM_HZ = 0.5  # a status tells the rate over 5 s: of slower ones it may be none
LATCHED = Qos(1, transient_local=True)  # what /tf_static is


class Ros2Publisher:
    """Publishes one sonar on a node that may have several.

    Parameters
    ----------
    node
        Entered already; who made it closes it.
    device_name
        As in events.
    info
        As on the sonar's ``info`` key: what hardware it is, and where it sits on the robot.
    """

    name = "ROS 2"

    def __init__(self, node: RosNode, device_name: str, info: Mapping[str, Any]) -> None:
        config = node.config
        self._stack = ExitStack()

        def publisher(kind: str, topic: str, qos: Qos) -> RosPublisher:
            made = node.publisher(kind, topic, qos)
            self._stack.callback(made.close)
            return made

        topic = config.detections_topic or f"{ros_name(device_name)}/detections"
        self._detections = publisher(messages.DETECTIONS, topic, LATEST_10)
        self._diagnosis = convert.Diagnosis(device_name)
        self._diagnostics: RosPublisher | None = None
        if config.diagnostics_topic:
            self._diagnostics = publisher(messages.DIAGNOSTICS, config.diagnostics_topic, LATEST_10)
        self._chooser: DockChooser | None = None
        if config.dock_class and config.dock_sonar in ("", device_name):
            self._chooser = DockChooser(config.dock_class, config.dock_min_probability)
            self._dock = publisher(messages.POSE, config.dock_topic, LATEST_10)
        self._publisher = publisher
        self._transform: RosPublisher | None = None
        self._mounting: Any = None
        self.describe(info, {})

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Take what hardware it is; publish where it sits on the robot if that is new."""
        self._diagnosis.hardware_id = str(info["address"])
        self._diagnosis.expects_pings = pings_by_itself(effective_config)
        mounting = info.get("transform")
        if mounting and mounting != self._mounting:
            if self._transform is None:
                self._transform = self._publisher(messages.TRANSFORMS, "/tf_static", LATCHED)
            self._transform.put(static_transform(mounting, time.time_ns()))
        self._mounting = mounting

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

    def publish_raw(self, frame: PdmFrame) -> None:
        """ROS has no message for a frame: nothing."""

    def close(self) -> None:
        """Take this sonar's topics off the network; the node stays. May be called twice."""
        self._stack.close()


def pings_by_itself(config: Mapping[str, Any]) -> bool:
    """Whether a sonar so configured pings without being asked, and often enough to be missed."""
    rate_hz = float(config.get("ping_rate_hz", 0.0))
    return config.get("ping_on", "timer") == "timer" and not 0.0 < rate_hz < SELDOM_HZ


def static_transform(mounting: Mapping[str, Any], time_ns: int) -> Any:
    """Return where a sonar sits, as a ``TFMessage`` of one transform."""
    transform = messages.new(
        "geometry_msgs/msg/Transform",
        translation=messages.vector(mounting["translation_m"]),
        rotation=messages.quaternion(mounting["rotation_xyzw"]),
    )
    stamped = messages.new(
        "geometry_msgs/msg/TransformStamped",
        header=messages.header(time_ns, mounting["parent_frame_id"]),
        child_frame_id=mounting["child_frame_id"],
        transform=transform,
    )
    return messages.new(messages.TRANSFORMS, transforms=[stamped])
