"""Where the robot says that it is: poses over Zenoh, and the sonar's motion between pings."""

from __future__ import annotations

import json
import logging
import math
from collections import deque
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ertis_daemon.config import OdometryConfig, PoseConfig
from ertis_detector.motion import Motion, PlanarPose, wrap

log = logging.getLogger(__name__)

POSES_WAITING = 1024  # between two pings; at 100 a second that is 10 s
MAX_PAYLOAD_BYTES = 4096
# A robot's pose that jumps farther was set anew, by its odometry's restart or its localisation.
MAX_JUMP_M_S, MAX_JUMP_M = 20.0, 0.1
MAX_TURN_RAD_S, MAX_TURN_RAD = 20.0, 0.2
# Two poses nearer to each other in time tell no speed: their rounding alone would be metres.
MIN_APART_NS = 5_000_000
_GUESSED_PART = 0.5  # one sigma of what is extrapolated, of its length


class PoseChannel(Protocol):
    """A Zenoh subscriber with a channel."""

    def try_recv(self) -> Any:
        """The oldest sample that waits, or None."""


@dataclass(frozen=True, slots=True)
class AtPing:
    """What odometry says at a ping.

    motion : Motion or None
        Of the sonar since the ping before; None for the first and if either place is not known.
    is_known : bool
        Whether the sonar's place at this ping is known.
    garbled : int
        Samples since the ping before that were no poses.
    """

    motion: Motion | None
    is_known: bool
    garbled: int


@dataclass(frozen=True, slots=True)
class _Place:
    """Pose of the robot and how far it may be from there for having been extrapolated."""

    pose: PlanarPose
    sigma_m: float = 0.0
    sigma_rad: float = 0.0


class Odometry:
    """Keeps the robot's latest poses and tells how the sonar moved from ping to ping.

    A sample is JSON, ``{"time_ns": .., "x_m": .., "y_m": .., "yaw_rad": ..}``; EVENTS.md has it.
    All is done in the thread that asks: Zenoh's only fill the channel.

    Parameters
    ----------
    config : OdometryConfig
        For the greatest age.
    pose : PoseConfig or None
        The sonar's place on the robot; None for the robot's origin.
    """

    def __init__(self, config: OdometryConfig, pose: PoseConfig | None = None) -> None:
        pose = pose or PoseConfig()
        self._max_age_ns = round(config.max_age_s * 1e9)
        self._mount = PlanarPose(pose.x_m, pose.y_m, math.radians(pose.yaw_deg))
        self._channel: PoseChannel | None = None
        self._poses: deque[tuple[int, PlanarPose]] = deque(maxlen=POSES_WAITING)
        self._garbled = 0
        self._at_last_ping: _Place | None = None

    def listen(self, channel: PoseChannel) -> None:
        """Take poses from this channel from now on."""
        self._channel = channel

    def add(self, payload: bytes) -> None:
        """Take in one sample; what is no pose is counted and left out."""
        sample = _read(payload)
        if sample is None:
            self._garbled += 1
            log.debug("no pose: %r", payload[:100])
            return
        if self._poses and not self._continues(*sample):
            if 0 <= self._poses[-1][0] - sample[0] <= self._max_age_ns:
                return  # told twice, or overtaken on the way
            log.warning("the robot's pose jumped: odometry starts again")
            self._poses.clear()
            self._at_last_ping = None
        self._poses.append(sample)

    def at_ping(self, ping_time_ns: int) -> AtPing:
        """Read what has come, and tell how the sonar moved since this was asked last."""
        while self._channel is not None and (sample := self._channel.try_recv()) is not None:
            self.add(sample.payload.to_bytes())
        place, before = self._place(ping_time_ns), self._at_last_ping
        self._at_last_ping = place
        garbled, self._garbled = self._garbled, 0
        motion = None if place is None or before is None else self._motion(before, place)
        return AtPing(motion, place is not None, garbled)

    def _continues(self, time_ns: int, pose: PlanarPose) -> bool:
        """Whether a pose may follow the latest one."""
        latest_ns, latest = self._poses[-1]
        step_m = math.hypot(pose.x_m - latest.x_m, pose.y_m - latest.y_m)
        turn_rad = abs(wrap(pose.yaw_rad - latest.yaw_rad))
        elapsed_s = (time_ns - latest_ns) / 1e9
        return (
            elapsed_s > 0
            and step_m <= MAX_JUMP_M + MAX_JUMP_M_S * elapsed_s
            and turn_rad <= MAX_TURN_RAD + MAX_TURN_RAD_S * elapsed_s
        )

    def _place(self, time_ns: int) -> _Place | None:
        """Where the robot was: between two poses, or a little after the latest."""
        if not self._poses or time_ns < self._poses[0][0]:
            return None
        later = next((n for n, (at, _) in enumerate(self._poses) if at >= time_ns), None)
        if later is None:
            return self._extrapolated(time_ns)
        if later == 0:
            return _Place(self._poses[0][1])
        before, after = self._poses[later - 1], self._poses[later]
        if after[0] - before[0] > self._max_age_ns:
            return None
        return _Place(_between(before, after, time_ns))

    def _extrapolated(self, time_ns: int) -> _Place | None:
        latest_ns, latest = self._poses[-1]
        apart = (one for one in reversed(self._poses) if latest_ns - one[0] >= MIN_APART_NS)
        earlier = next(apart, None)
        if time_ns - latest_ns > self._max_age_ns or earlier is None:
            return None
        pose = _between(earlier, self._poses[-1], time_ns)
        length_m = math.hypot(pose.x_m - latest.x_m, pose.y_m - latest.y_m)
        turn_rad = abs(wrap(pose.yaw_rad - latest.yaw_rad))
        return _Place(pose, _GUESSED_PART * length_m, _GUESSED_PART * turn_rad)

    def _motion(self, before: _Place, now: _Place) -> Motion:
        exact = Motion.between(before.pose.then(self._mount), now.pose.then(self._mount))
        place_m2 = before.sigma_m**2 + now.sigma_m**2
        yaw_rad2 = before.sigma_rad**2 + now.sigma_rad**2
        # A robot that turns on the spot carries the sonar around it.
        arm_m2 = self._mount.x_m**2 + self._mount.y_m**2
        place_m2 += arm_m2 * yaw_rad2
        guessed = np.diag([place_m2, place_m2, yaw_rad2])
        return Motion(exact.step, exact.covariance + guessed)


def _between(a: tuple[int, PlanarPose], b: tuple[int, PlanarPose], time_ns: int) -> PlanarPose:
    """Linear in time through two poses, within and beyond them."""
    part = (time_ns - a[0]) / (b[0] - a[0])
    turn = wrap(b[1].yaw_rad - a[1].yaw_rad)
    return PlanarPose(
        a[1].x_m + part * (b[1].x_m - a[1].x_m),
        a[1].y_m + part * (b[1].y_m - a[1].y_m),
        wrap(a[1].yaw_rad + part * turn),
    )


def _read(payload: bytes) -> tuple[int, PlanarPose] | None:
    if len(payload) > MAX_PAYLOAD_BYTES:
        return None
    try:
        value = json.loads(payload)
        time_ns = value["time_ns"]
        x_m, y_m, yaw_rad = (value[key] for key in ("x_m", "y_m", "yaw_rad"))
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    numbers = (x_m, y_m, yaw_rad)
    if type(time_ns) is not int or not 0 <= time_ns < 2**63:
        return None
    if any(type(n) not in (int, float) for n in numbers):
        return None
    try:
        pose = PlanarPose(float(x_m), float(y_m), wrap(float(yaw_rad)))
    except (OverflowError, ValueError):
        return None
    return (time_ns, pose) if all(map(math.isfinite, (pose.x_m, pose.y_m, pose.yaw_rad))) else None
