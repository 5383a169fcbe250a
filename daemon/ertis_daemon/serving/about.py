"""What a sonar tells about itself on its ``info`` key."""

from __future__ import annotations

import math
from typing import Any

from ertis_daemon.about import version
from ertis_daemon.config import PoseConfig, SonarConfig
from ertis_daemon.pipeline import Pipeline
from ertis_driver.device import DeviceInfo, Settings


def waiting_info(config: SonarConfig) -> dict[str, Any]:
    """What is known before the sonar was first opened."""
    return {
        "version": version(),
        "device": config.device.name,
        "address": config.device.address,
        "frame_id": config.device.frame_id,
        "transform": transform(config.pose, config.device.frame_id),
    }


def sonar_info(
    config: SonarConfig, info: DeviceInfo, settings: Settings, pipeline: Pipeline
) -> dict[str, Any]:
    """What is known of an open sonar."""
    return {
        **waiting_info(config),
        "address": info.address,
        "firmware": info.firmware,
        "source": info.source,
        "chirp": settings.chirp.name,
        "num_words": settings.num_words,
        "model": pipeline.model_name,
        "classes": list(pipeline.classes),
    }


def transform(pose: PoseConfig, frame_id: str) -> dict[str, Any] | None:
    """The static transform from the sonar's frame to its parent's; None if there is no parent.

    ``translation_m`` is x, y, z; ``rotation_xyzw`` a unit quaternion, as in ROS.
    """
    if not pose.parent_frame:
        return None
    return {
        "parent_frame_id": pose.parent_frame,
        "child_frame_id": frame_id,
        "translation_m": [pose.x_m, pose.y_m, pose.z_m],
        "rotation_xyzw": quaternion(pose.roll_deg, pose.pitch_deg, pose.yaw_deg),
    }


def quaternion(roll_deg: float, pitch_deg: float, yaw_deg: float) -> list[float]:
    """x, y, z, w of a turn about fixed x, then y, then z (REP-103)."""
    halves = (math.radians(angle) / 2 for angle in (roll_deg, pitch_deg, yaw_deg))
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(half), math.sin(half)) for half in halves)
    return [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
