"""Scenes in YAML: degrees for the reader, rad inside; unknown keys are errors."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ertis_detector.air import Air
from ertis_simulator.clutter import Clutter
from ertis_simulator.errors import SceneError
from ertis_simulator.landmark import DEPTH_RATIO, RADII_MM, Dish
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

MAX_SCENE_BYTES = 65_536

_TOP = {"name", "seed", "air", "room", "sonar", "landmarks", "decoys", "clutter_per_m2"}
_ROOM = {"x_m", "y_m", "wall_reflection", "floor_reflection"}
_SONAR = {"x_m", "y_m", "height_m", "heading_deg", "velocity_m_s", "turn_deg_s", "ping_period_s"}
_DISH = {"x_m", "y_m", "height_m", "facing_deg"}
_DECOY = _DISH | {"name", "radius_mm", "depth_mm"}
_LANDMARK = _DISH | {"radius_mm"}


def load_scene(path: Path) -> Scene:
    """Read a scene.

    Raises
    ------
    SceneError
        One line: what, where, and what was expected.
    """
    try:
        if path.stat().st_size > MAX_SCENE_BYTES:
            raise SceneError(f"{path}: larger than {MAX_SCENE_BYTES} bytes: that is no scene")
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not text"
        raise SceneError(f"scene {path}: {reason}") from error
    except (yaml.YAMLError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise SceneError(f"{path}{where}: not YAML: {getattr(error, 'problem', error)}") from error
    try:
        return _scene(_Section(content, "", _TOP), path.stem)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from error


class _Section:
    """A mapping with known keys; says what is wrong where."""

    def __init__(self, content: Any, name: str, known: set[str]) -> None:
        if not isinstance(content, Mapping):
            raise SceneError(f"{name or 'the file'}: met {content!r}, expected a mapping")
        for key in content:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, 1)
                hint = (
                    f"did you mean {near[0]!r}?" if near else f"known: {', '.join(sorted(known))}"
                )
                raise SceneError(f"{name + '.' if name else ''}{key}: unknown key, {hint}")
        self._content, self.name = content, name

    def number(
        self,
        key: str,
        default: float | None = None,
        *,
        low: float = -1e6,
        high: float = 1e6,
    ) -> float:
        value = self._content.get(key, default)
        where = f"{self.name}.{key}" if self.name else key
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise SceneError(f"{where}: met {value!r}, expected a number")
        if not low <= value <= high:
            raise SceneError(f"{where}: met {value:g}, expected {low:g} to {high:g}")
        return float(value)

    def pair(self, key: str, default: tuple[float, float]) -> tuple[float, float]:
        value = self._content.get(key, default)
        numbers = isinstance(value, (list, tuple)) and len(value) == 2
        if not numbers or not all(type(v) in (int, float) and np.isfinite(v) for v in value):
            raise SceneError(f"{self.name}.{key}: met {value!r}, expected two numbers")
        return float(value[0]), float(value[1])

    def text(self, key: str, default: str) -> str:
        return str(self._content.get(key, default))

    def section(self, key: str, known: set[str]) -> _Section:
        return _Section(self._content.get(key, {}), key, known)

    def sections(self, key: str, known: set[str]) -> list[_Section]:
        items = self._content.get(key, [])
        if not isinstance(items, list):
            raise SceneError(f"{key}: met {items!r}, expected a list")
        return [_Section(item, f"{key}[{i}]", known) for i, item in enumerate(items)]


def _scene(top: _Section, name: str) -> Scene:
    seed = int(top.number("seed", 0, low=0, high=2**31))
    room = _room(top.section("room", _ROOM))
    sonar = top.section("sonar", _SONAR)
    air = top.section("air", {"temperature_c", "humidity_percent"})
    rng = np.random.default_rng([seed, 7])
    return Scene(
        room=room,
        start=Pose(
            (
                sonar.number("x_m", 0.0),
                sonar.number("y_m", 0.0),
                sonar.number("height_m", 0.5, low=0.05, high=5.0),
            ),
            float(np.deg2rad(sonar.number("heading_deg", 0.0))),
        ),
        dishes=tuple(
            [_landmark(item) for item in top.sections("landmarks", _LANDMARK)]
            + [_decoy(item) for item in top.sections("decoys", _DECOY)]
        ),
        clutter=Clutter.scatter(
            room.x_m, room.y_m, top.number("clutter_per_m2", 0.0, low=0.0, high=100.0), rng
        ),
        air=Air(
            air.number("temperature_c", 20.0, low=-40.0, high=60.0),
            air.number("humidity_percent", 50.0, low=1.0, high=100.0),
        ),
        velocity_m_s=sonar.pair("velocity_m_s", (0.0, 0.0)),
        yaw_rate_rad_s=float(np.deg2rad(sonar.number("turn_deg_s", 0.0))),
        ping_period_s=sonar.number("ping_period_s", 0.2, low=0.0, high=60.0),
        seed=seed,
        name=top.text("name", name),
    )


def _room(section: _Section) -> Room:
    default = Room()
    sides = {key: section.pair(key, getattr(default, key)) for key in ("x_m", "y_m")}
    for key, (low, high) in sides.items():
        if not 0 < high - low <= 100:
            raise SceneError(f"room.{key}: met {low:g} to {high:g}, expected a width up to 100")
    return Room(
        sides["x_m"],
        sides["y_m"],
        section.number("wall_reflection", default.wall_reflection, low=0.0, high=1.0),
        section.number("floor_reflection", default.floor_reflection, low=0.0, high=1.0),
    )


def _place(section: _Section) -> tuple[tuple[float, float, float], tuple[float, float]]:
    vertex = section.number("x_m"), section.number("y_m"), section.number("height_m", 0.5)
    return vertex, (float(np.deg2rad(section.number("facing_deg", 180.0))), 0.0)


def _landmark(section: _Section) -> DishObject:
    radius_mm = section.number("radius_mm")
    if radius_mm not in RADII_MM:
        raise SceneError(
            f"{section.name}.radius_mm: met {radius_mm:g}, expected one of "
            f"{', '.join(map(str, RADII_MM))}"
        )
    vertex, facing = _place(section)
    return DishObject(f"r{radius_mm:g}", Dish.landmark(radius_mm), vertex, facing)


def _decoy(section: _Section) -> DishObject:
    radius_mm = section.number("radius_mm")
    depth_mm = section.number("depth_mm", DEPTH_RATIO * radius_mm)
    if not 0 < depth_mm <= 2 * radius_mm:
        raise SceneError(
            f"{section.name}.depth_mm: met {depth_mm:g}, expected above 0 and up to twice the "
            "radius"
        )
    vertex, facing = _place(section)
    dish = Dish(radius_mm / 1000, depth_mm / 1000)
    return DishObject(section.text("name", "bowl"), dish, vertex, facing, is_landmark=False)
