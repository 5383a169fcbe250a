"""What can be set of the ROS 2 side."""

from __future__ import annotations

import re
from dataclasses import dataclass

from ertis_daemon.yaml_load import option

MAX_DOMAIN_ID = 232  # what every ROS 2 middleware takes
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC = re.compile(rf"/?{_NAME.pattern}(/{_NAME.pattern})*")


def _check_node(value: str) -> str | None:
    if _NAME.fullmatch(value):
        return None
    return f"{value!r}, expected a ROS name: letters, digits and _, no digit first"


def _check_topic(value: str) -> str | None:
    if not value or _TOPIC.fullmatch(value):
        return None
    return f"{value!r}, expected a ROS topic such as sonar/detections or /diagnostics"


def _check_namespace(value: str) -> str | None:
    if value == "/" or (value.startswith("/") and _TOPIC.fullmatch(value)):
        return None
    return f"{value!r}, expected a ROS namespace: / or one such as /robot1"


@dataclass(frozen=True, slots=True)
class Ros2Config:
    """Messages for ROS 2, in rmw_zenoh's wire format; needs the extra 'ros2', but no ROS."""

    enabled: bool = option(False, "publish for ROS 2 as well")
    domain_id: int = option(
        -1, "ROS domain; -1 for that in ROS_DOMAIN_ID, or 0", low=-1, high=MAX_DOMAIN_ID
    )
    namespace: str = option("/", "of the node and its relative topics", check=_check_namespace)
    node: str = option("ertis", "name of the node", check=_check_node)
    detections_topic: str = option(
        "", "vision_msgs/Detection3DArray; empty for NAME/detections", check=_check_topic
    )
    diagnostics_topic: str = option(
        "/diagnostics", "diagnostic_msgs/DiagnosticArray; empty for none", check=_check_topic
    )
    dock_class: str = option(
        "", "landmark class to dock at, such as r58; empty for no docking topic"
    )
    dock_min_probability: float = option(0.9, "a landmark less probable is no dock", low=0, high=1)
    dock_topic: str = option(
        "detected_dock_pose", "geometry_msgs/PoseStamped of the dock", check=_check_topic
    )
    dock_sonar: str = option("", "name of the sonar that looks for the dock; empty for any")


def ros_name(name: str) -> str:
    """Return a sonar's name as ROS allows it.

    >>> ros_name("front-left"), ros_name("2nd")
    ('front_left', '_2nd')
    """
    text = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return text if _NAME.fullmatch(text) else f"_{text}"
