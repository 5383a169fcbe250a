"""Drives through random rooms without a landmark: what a tracker must not believe."""

from __future__ import annotations

import dataclasses
import math

from ertis_simulator.dataset import random_scene
from ertis_simulator.path import Path
from ertis_simulator.scene import Scene

PING_RATE_HZ, SPEED_M_S = 7.0, 0.5
_MAX_DRIVE_M, _WALL_GAP_M = 4.0, 0.8


def random_drive(seed: int, number: int) -> tuple[Scene, int]:
    """Drive ``number`` of those that ``seed`` names, and its number of pings.

    Through the room of a random training scene; dishes are left out, landmarks and bowls.
    """
    empty = dataclasses.replace(
        random_scene(seed, number), dishes=(), name=f"drive {seed}/{number}"
    )
    scene, steps = straight_ahead(empty)
    return scene, steps + 1


def straight_ahead(scene: Scene) -> tuple[Scene, int]:
    """The scene, driven through at 0.5 m/s and 7 pings a second; and its steps between pings.

    Straight on from where the sonar stands, until a wall is near.
    """
    x, y, _ = scene.start.position_m
    yaw = scene.start.yaw_rad
    length_m = min(scene.room.x_m[1] - x - _WALL_GAP_M, _MAX_DRIVE_M)
    end = (x + length_m * math.cos(yaw), y + length_m * math.sin(yaw))
    drive = dataclasses.replace(
        scene,
        path=Path((0.0, length_m / SPEED_M_S), ((x, y), end), (yaw, yaw)),
        ping_period_s=1.0 / PING_RATE_HZ,
    )
    return drive, int(length_m / SPEED_M_S * PING_RATE_HZ)
