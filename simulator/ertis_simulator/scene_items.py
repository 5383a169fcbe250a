"""What the lists of a scene file hold: landmarks, decoys, objects, noise, waypoints."""

from __future__ import annotations

import numpy as np

from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
from ertis_driver.errors import SettingsError
from ertis_simulator.landmark import DEPTH_RATIO, RADII_MM, RIM_STRENGTH, Dish
from ertis_simulator.noise_sources import AirGun, NoiseSource, OtherSonar, Tone
from ertis_simulator.objects import (
    DISH_KINDS,
    SIZES,
    DishObject,
    Thing,
    draw_sizes,
    make_thing,
)
from ertis_simulator.path import Path
from ertis_simulator.room import Room
from ertis_simulator.yaml_section import Section

_DISH = ("x_m", "y_m", "height_m", "facing_deg", "tilt_up_deg", "path", "rim_strength")
LANDMARK_KEYS = (*_DISH, "radius_mm")
DECOY_KEYS = (*_DISH, "name", "radius_mm", "depth_mm")
# The file says millimetres where a ruler does.
_SIZE_KEYS = {"radius_m": "radius_mm", "side_m": "side_mm"}
OBJECT_KEYS = (
    "kind",
    "x_m",
    "y_m",
    "facing_deg",
    "path",
    "radius_mm",
    "side_mm",
    "depth_mm",
    "width_m",
    "depth_m",
    "height_m",
    "base_m",
    "top_m",
)
_NOISE = {
    "tone": ("frequency_hz",),
    "air_gun": ("per_s", "duration_s"),
    "sonar": ("per_s", "chirp"),
}
NOISE_KEYS = ("kind", "level_dbfs", "azimuth_deg", "frequency_hz", "per_s", "duration_s", "chirp")
_MAX_HEIGHT_M = 100.0
_WAYPOINT = ("t_s", "x_m", "y_m", "heading_deg")


def check_within(section: Section, room: Room, x_m: float, y_m: float) -> None:
    """Raise SceneError if a place is behind one of the room's walls."""
    for key, value, (low, high) in (("x_m", x_m, room.x_m), ("y_m", y_m, room.y_m)):
        if not low <= value <= high:
            problem = f"met {value:g}, expected {low:g} to {high:g}, between the walls (room.{key})"
            raise section.wrong(key, problem)


def read_landmark(section: Section, room: Room) -> DishObject:
    """One of the four printed dishes."""
    radius_mm = section.number("radius_mm")
    if radius_mm not in RADII_MM:
        known = ", ".join(map(str, RADII_MM))
        raise section.wrong("radius_mm", f"met {radius_mm:g}, expected one of {known}")
    return _dish(section, f"r{radius_mm:g}", Dish.landmark(radius_mm), room, is_landmark=True)


def read_decoy(section: Section, room: Room) -> DishObject:
    """A dish of any other shape."""
    radius_mm = section.number("radius_mm", low=1.0, high=1000.0)
    depth_mm = section.number("depth_mm", DEPTH_RATIO * radius_mm, low=0.1)
    if depth_mm > 2 * radius_mm:
        problem = f"met {depth_mm:g}, expected above 0 and up to twice the radius"
        raise section.wrong("depth_mm", problem)
    dish = Dish(radius_mm / 1000, depth_mm / 1000)
    return _dish(section, section.text("name", "bowl"), dish, room, is_landmark=False)


def _dish(section: Section, label: str, dish: Dish, room: Room, *, is_landmark: bool) -> DishObject:
    x_m, y_m = _place(section, room)
    vertex = x_m, y_m, section.number("height_m", 0.5, low=0.0, high=_MAX_HEIGHT_M)
    azimuth = float(np.deg2rad(section.number("facing_deg", 180.0)))
    up = float(np.deg2rad(section.number("tilt_up_deg", 0.0, low=-90.0, high=90.0)))
    return DishObject(
        label,
        dish,
        vertex,
        (azimuth, up),
        is_landmark,
        read_path(section, azimuth, room, (x_m, y_m)),
        section.number("rim_strength", RIM_STRENGTH, low=0.0, high=1.0),
    )


def read_object(
    section: Section, rng: np.random.Generator, room: Room
) -> tuple[Thing | None, DishObject | None]:
    """A named thing; bowls and lampshades come as dishes. Sizes not given are drawn."""
    kind = section.text("kind", choices=tuple(SIZES))
    given: dict[str, float] = {}
    allowed = set()
    for name in SIZES[kind]:
        key = _SIZE_KEYS.get(name, name)
        if kind in DISH_KINDS and name == "depth_m":
            key = "depth_mm"
        allowed.add(key)
        if section.has(key):
            low = 0.0 if name in ("base_m", "top_m", "height_m") else 1e-3
            value = section.number(key, low=low)
            given[name] = value / 1e3 if key.endswith("_mm") else value
    for key in set(OBJECT_KEYS) - {"kind", "x_m", "y_m", "facing_deg", "path"} - allowed:
        if section.has(key):
            known = ", ".join(sorted(allowed))
            raise section.wrong(key, f"a {kind} has none, its sizes are {known}")
    if kind in DISH_KINDS and given.get("depth_m", 0.0) > 2 * given.get("radius_m", np.inf):
        raise section.wrong(
            "depth_mm", f"met {given['depth_m'] * 1e3:g}, expected up to twice the radius"
        )
    x_m, y_m = _place(section, room)
    facing = float(np.deg2rad(section.number("facing_deg", 180.0)))
    path = read_path(section, facing, room, (x_m, y_m))
    sizes = draw_sizes(kind, given, rng)
    if kind in DISH_KINDS:
        dish = Dish(sizes["radius_m"], sizes["depth_m"])
        at = (x_m, y_m, sizes["height_m"])
        return None, DishObject(kind, dish, at, (facing, 0.0), is_landmark=False, path=path)
    if sizes.get("top_m", 1.0) <= sizes.get("base_m", 0.0):
        raise section.wrong("top_m", f"met {sizes['top_m']:g}, expected above the base")
    return make_thing(kind, x_m, y_m, facing, sizes, rng, path), None


def _place(section: Section, room: Room) -> tuple[float, float]:
    x_m, y_m = section.number("x_m"), section.number("y_m")
    check_within(section, room, x_m, y_m)
    return x_m, y_m


def read_path(
    section: Section, yaw_rad: float, room: Room, start_m: tuple[float, float] | None = None
) -> Path | None:
    """Waypoints with times; a heading not given is that of the waypoint before.

    What stands at ``start_m`` moves as from the first waypoint to the others.
    """
    if not section.has("path"):
        return None
    points = section.sections("path", _WAYPOINT)
    if not points:
        raise section.wrong("path", "met no waypoint, expected one at least")
    times = [point.number("t_s", low=0.0) for point in points]
    for before, after, point in zip(times[:-1], times[1:], points[1:], strict=True):
        if after <= before:
            problem = f"met {after:g} after {before:g}, expected rising times"
            raise point.wrong("t_s", problem)
    yaws: list[float] = []
    for point in points:
        held = yaws[-1] if yaws else yaw_rad
        yaws.append(float(np.deg2rad(point.number("heading_deg", np.rad2deg(held)))))
    places = tuple((point.number("x_m"), point.number("y_m")) for point in points)
    from_m = np.subtract(places[0] if start_m is None else start_m, places[0])
    for point, place in zip(points, places, strict=True):
        check_within(point, room, *(from_m + place))
    return Path(tuple(times), places, tuple(yaws))


def read_noise(section: Section) -> NoiseSource:
    """A machine, an air gun or another sonar."""
    kind = section.text("kind", choices=tuple(_NOISE))
    for other, keys in _NOISE.items():
        for key in keys:
            if section.has(key) and key not in _NOISE[kind]:
                raise section.wrong(key, f"belongs to {other}, met in {kind}")
    level = section.number("level_dbfs", low=-140.0, high=0.0)
    azimuth = float(np.deg2rad(section.number("azimuth_deg", 0.0)))
    if kind == "tone":
        frequency_hz = section.number("frequency_hz", low=10.0, high=200e3)
        return Tone(frequency_hz, level, azimuth)
    per_s = section.number("per_s", 2.0 if kind == "air_gun" else 10.0, low=0.01, high=100.0)
    if kind == "air_gun":
        duration_s = section.number("duration_s", 0.15, low=1e-3, high=10.0)
        return AirGun(level, per_s, duration_s, azimuth)
    try:
        chirp = Chirp.parse(section.text("chirp", DEFAULT_CHIRP.name))
    except SettingsError as error:
        raise section.wrong("chirp", str(error)) from error
    return OtherSonar(level, per_s, chirp, azimuth)
