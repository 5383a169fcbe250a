"""Events and status as ROS messages."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from ertis_daemon.events import LandmarkEvent, LandmarkReport
from ertis_daemon.ros2 import geometry, messages
from ertis_detector.detection import NONE

OK, WARN, ERROR, STALE = 0, 1, 2, 3  # diagnostic_msgs/DiagnosticStatus
_LEVELS = {"starting": WARN, "waiting": WARN, "ended": STALE}
_LEVELS |= dict.fromkeys(("away", "stalled", "failed"), ERROR)

# What a healthy sonar does not count; EVENTS.md explains each.
_TROUBLE = (
    *("pings_lost", "frames_corrupt", "timeouts", "pings_away"),
    *("queue_drops", "half_words_repaired", "pings_failed", "publish_failures"),
)


def detections(event: LandmarkEvent) -> Any:
    """Return the landmarks heard in one ping as a ``Detection3DArray``.

    Stamped with the time of the ping, in the sonar's frame. A landmark that was lost is not in it;
    one whose range is unknown has no place and is not, either.
    """
    header = messages.header(event.ping_time_ns, event.frame_id)
    heard = [
        _detection(report, header)
        for report in event.landmarks
        if report.state != "lost" and math.isfinite(report.range_m)
    ]
    return messages.new(messages.DETECTIONS, header=header, detections=heard)


def _detection(report: LandmarkReport, header: Any) -> Any:
    bearing = (report.azimuth_rad, report.elevation_rad)
    xyz_m = geometry.position(report.range_m, *bearing)
    pose = messages.pose(xyz_m, geometry.line_of_sight(*bearing))
    covariance = geometry.cartesian_covariance(report.range_m, *bearing, report.covariance)
    placed = messages.new(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=pose,
        covariance=geometry.pose_covariance(covariance),
    )
    size_m = 2.0 * (report.radius_m or 0.0)
    return messages.new(
        "vision_msgs/msg/Detection3D",
        header=header,
        results=[_hypothesis(*item, placed) for item in _classes(report)],
        bbox=messages.new(
            "vision_msgs/msg/BoundingBox3D", center=pose, size=messages.vector([size_m] * 3)
        ),
        id=str(report.track_id),
    )


def _classes(report: LandmarkReport) -> list[tuple[str, float]]:
    """Classes with their probabilities, the reported one first; ``none`` is no object."""
    pairs = [(label, p) for label, p in report.probabilities.items() if label != NONE]
    return sorted(pairs, key=lambda pair: (pair[0] != report.label, -pair[1]))


def _hypothesis(label: str, probability: float, placed: Any) -> Any:
    hypothesis = messages.new(
        "vision_msgs/msg/ObjectHypothesis", class_id=label, score=float(probability)
    )
    return messages.new(
        "vision_msgs/msg/ObjectHypothesisWithPose", hypothesis=hypothesis, pose=placed
    )


def dock_pose(event: LandmarkEvent, report: LandmarkReport) -> Any:
    """Return one landmark as a ``PoseStamped``, which looks along the line of sight."""
    bearing = (report.azimuth_rad, report.elevation_rad)
    return messages.new(
        messages.POSE,
        header=messages.header(event.ping_time_ns, event.frame_id),
        pose=messages.pose(
            geometry.position(report.range_m, *bearing), geometry.line_of_sight(*bearing)
        ),
    )


class Diagnosis:
    """Turns status after status into diagnostics: what matters is what was counted in between.

    Parameters
    ----------
    device
        The sonar's name.

    Attributes
    ----------
    hardware_id : str
        Which one it is: its address.
    expects_pings : bool
        Whether hearing none for some seconds is worth a warning: not if others ask for them.
    """

    def __init__(self, device: str) -> None:
        self._name = f"ertis: {device}"
        self.hardware_id = ""
        self.expects_pings = True
        self._before: dict[str, float] = {}

    def message(self, status: Mapping[str, Any], time_ns: int) -> Any:
        """Return a status as a ``DiagnosticArray`` of one entry.

        ERROR if the sonar is away, silent or has failed, STALE if its service has ended, WARN if
        something was lost, repaired or failed since the one before or a microphone is faulty.
        """
        level, text = self._judge(status)
        entry = messages.new(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=level,
            name=self._name,
            message=text,
            hardware_id=self.hardware_id,
            values=[
                messages.new("diagnostic_msgs/msg/KeyValue", key=key, value=_text(value))
                for key, value in _flat(status)
            ],
        )
        header = messages.header(time_ns, "")
        return messages.new(messages.DIAGNOSTICS, header=header, status=[entry])

    def _judge(self, status: Mapping[str, Any]) -> tuple[int, str]:
        counted = {name: status.get(name) or 0 for name in ("pings_heard", *_TROUBLE)}
        more = {name: value - self._before.get(name, 0) for name, value in counted.items()}
        first, self._before = not self._before, counted
        notes = [f"{name} +{more[name]}" for name in _TROUBLE if more[name] > 0]
        notes += [f"microphone {m} {why}" for m, why in _named(status, "microphones_faulty")]
        notes += [f"{way}: {why}" for way, why in _named(status, "outputs_failing")]
        state = str(status.get("state", "running"))
        if state in _LEVELS:
            words = [state, str(status.get("reason") or "")]
            return _LEVELS[state], ", ".join(filter(None, [*words, *notes]))
        # The rate is over some seconds: two messages may stand between two pings.
        silent = more["pings_heard"] <= 0 and not status.get("ping_rate_hz")
        if silent and self.expects_pings and not first:
            return WARN, ", ".join(["no ping heard", *notes])
        return (WARN, ", ".join(notes)) if notes else (OK, "listening")


def _named(status: Mapping[str, Any], key: str) -> list[tuple[str, str]]:
    faulty = status.get(key)
    return list(faulty.items()) if isinstance(faulty, Mapping) else []


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", value))
    return pairs


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str)
