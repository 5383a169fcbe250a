"""Scenes in YAML: degrees for the reader, rad inside; unknown keys are errors."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np

from ertis_detector.air import Air
from ertis_driver.frame import NUM_MICS
from ertis_simulator.clutter import CLUSTER_KINDS, EVEN, Clutter
from ertis_simulator.errors import SceneError
from ertis_simulator.path import Pose
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Scene
from ertis_simulator.scene_items import (
    DECOY_KEYS,
    LANDMARK_KEYS,
    NOISE_KEYS,
    OBJECT_KEYS,
    check_within,
    read_decoy,
    read_landmark,
    read_noise,
    read_object,
    read_path,
)
from ertis_simulator.sensor_response import SensorResponse, shipped_response
from ertis_simulator.yaml_section import MAX_SCENE_BYTES, Section, read_yaml

__all__ = ["MAX_SCENE_BYTES", "load_scene"]

_TOP = (
    "name",
    "seed",
    "air",
    "room",
    "sonar",
    "landmarks",
    "stands",
    "decoys",
    "objects",
    "clutter_per_m2",
    "clutter_kinds",
    "noise",
    "dead_microphones",
    "sensor_response",
)
_ROOM = (
    "x_m",
    "y_m",
    "wall_reflection",
    "floor_reflection",
    "wall_roughness_mm",
    "floor_roughness_mm",
    "diffuse",
)
_SONAR = (
    "x_m",
    "y_m",
    "height_m",
    "heading_deg",
    "velocity_m_s",
    "turn_deg_s",
    "ping_period_s",
    "path",
)
_NEAREST_M = 0.05  # of a dish: nearer, it is in the sonar
_MAX_THINGS = 20_000  # clutter: as much again takes a minute a ping


def load_scene(path: FilePath) -> Scene:
    """Read a scene.

    Raises
    ------
    SceneError
        One line: file, line and column, what was met and what was expected.
    """
    top = read_yaml(path, _TOP)
    seed = int(top.number("seed", 0, low=0, high=2**31))
    room = _room(top)
    sonar = top.section("sonar", _SONAR)
    start = _start(sonar)
    if sonar is None:
        _check_default_place(top, room)
    elif not sonar.has("path"):
        check_within(sonar, room, *start.position_m[:2])
    objects = [
        (item, *read_object(item, np.random.default_rng([seed, 8, number]), room))
        for number, item in enumerate(top.sections("objects", OBJECT_KEYS))
    ]
    dishes = [
        (item, read_landmark(item, room)) for item in top.sections("landmarks", LANDMARK_KEYS)
    ]
    dishes.extend((item, read_decoy(item, room)) for item in top.sections("decoys", DECOY_KEYS))
    dishes.extend((item, dish) for item, _, dish in objects if dish is not None)
    air = top.section("air", ("temperature_c", "humidity_percent"))
    scene = Scene(
        room=room,
        start=start,
        dishes=tuple(dish for _, dish in dishes),
        clutter=_clutter(top, room, np.random.default_rng([seed, 7])),
        air=Air(
            air.number("temperature_c", 20.0, low=-40.0, high=60.0) if air else 20.0,
            air.number("humidity_percent", 50.0, low=1.0, high=100.0) if air else 50.0,
        ),
        velocity_m_s=sonar.pair("velocity_m_s", (0.0, 0.0)) if sonar else (0.0, 0.0),
        yaw_rate_rad_s=float(np.deg2rad(sonar.number("turn_deg_s", 0.0))) if sonar else 0.0,
        ping_period_s=sonar.number("ping_period_s", 0.2, low=0.0, high=60.0) if sonar else 0.2,
        seed=seed,
        name=top.text("name", path.stem),
        things=tuple(thing for _, thing, _ in objects if thing is not None),
        stands=top.flag("stands", False),
        path=read_path(sonar, start.yaw_rad, room) if sonar else None,
        noise=tuple(read_noise(item) for item in top.sections("noise", NOISE_KEYS)),
        dead_mics=_dead(top),
        sensor=_sensor(top, path.parent),
    )
    for section, dish in dishes:
        _check_apart(section, dish, scene)
    return scene


def _check_apart(section: Section, dish: DishObject, scene: Scene) -> None:
    distance_m = float(np.linalg.norm(np.subtract(dish.vertex_m, scene.pose(0).position_m)))
    if distance_m < _NEAREST_M:
        problem = f"met {distance_m:g} m from the sonar, expected {_NEAREST_M:g} at least"
        raise section.wrong("x_m", problem)


def _start(sonar: Section | None) -> Pose:
    if sonar is None:
        return Pose((0.0, 0.0, 0.5), 0.0)
    for other in ("velocity_m_s", "turn_deg_s", "x_m", "y_m"):
        if sonar.has("path") and sonar.has(other):
            raise sonar.wrong(other, "met beside path, expected one of the two")
    at = (
        sonar.number("x_m", 0.0),
        sonar.number("y_m", 0.0),
        sonar.number("height_m", 0.5, low=0.05, high=5.0),
    )
    return Pose(at, float(np.deg2rad(sonar.number("heading_deg", 0.0))))


def _check_default_place(top: Section, room: Room) -> None:
    section = top.section("room", _ROOM)
    for key, (low, high) in (("x_m", room.x_m), ("y_m", room.y_m)):
        if section is not None and not low <= 0 <= high:
            problem = f"met {low:g} to {high:g}, without 0, where the sonar is: give sonar.{key}"
            raise section.wrong(key, problem)


def _sensor(top: Section, folder: FilePath) -> SensorResponse:
    """The response measured on one's own sonar, in a file named from the scene's folder."""
    if not top.has("sensor_response"):
        return shipped_response()
    try:
        return SensorResponse.read(folder / top.text("sensor_response"))
    except SceneError as error:
        raise top.wrong("sensor_response", str(error)) from error


def _dead(top: Section) -> tuple[int, ...]:
    numbers = top.numbers("dead_microphones")
    for number in numbers:
        if number != int(number) or not 0 <= number < NUM_MICS:
            problem = f"met {number:g}, expected whole numbers from 0 to {NUM_MICS - 1}"
            raise top.wrong("dead_microphones", problem)
    return tuple(sorted({int(number) for number in numbers}))


def _clutter(top: Section, room: Room, rng: np.random.Generator) -> Clutter:
    density = top.number("clutter_per_m2", 0.0, low=0.0, high=100.0)
    area = (room.x_m[1] - room.x_m[0]) * (room.y_m[1] - room.y_m[0])
    if density * area > _MAX_THINGS:
        problem = f"met {density:g} in a room of {area:g} m2, expected {_MAX_THINGS} things at most"
        raise top.wrong("clutter_per_m2", problem)
    shares = top.section("clutter_kinds", tuple(CLUSTER_KINDS))
    weights = EVEN
    if shares is not None:
        weights = {name: shares.number(name, 0.0, low=0.0) for name in CLUSTER_KINDS}
        if not sum(weights.values()):
            raise top.wrong("clutter_kinds", "met no share above 0, expected one at least")
    return Clutter.scatter(room.x_m, room.y_m, density, rng, weights=weights)


def _room(top: Section) -> Room:
    default, section = Room(), top.section("room", _ROOM)
    if section is None:
        return default
    sides = {key: section.pair(key, getattr(default, key)) for key in ("x_m", "y_m")}
    for key, (low, high) in sides.items():
        if not 0 < high - low <= 100:
            problem = f"met {low:g} to {high:g}, expected a width up to 100"
            raise section.wrong(key, problem)
    wall_mm, floor_mm = default.wall_roughness_m * 1e3, default.floor_roughness_m * 1e3
    return Room(
        sides["x_m"],
        sides["y_m"],
        section.number("wall_reflection", default.wall_reflection, low=0.0, high=1.0),
        section.number("floor_reflection", default.floor_reflection, low=0.0, high=1.0),
        section.number("wall_roughness_mm", wall_mm, low=0.0, high=10.0) / 1e3,
        section.number("floor_roughness_mm", floor_mm, low=0.0, high=10.0) / 1e3,
        section.number("diffuse", default.diffuse, low=0.0, high=1.0),
    )
