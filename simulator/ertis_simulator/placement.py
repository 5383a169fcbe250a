"""Where things are put in a room: spots seen from the sonar, and what is cleared away for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ertis_simulator.clutter import Clutter
from ertis_simulator.environments import Place
from ertis_simulator.landmark import Dish
from ertis_simulator.objects import DISH_KINDS, DishObject, Thing, draw_sizes, make_thing, rod
from ertis_simulator.path import Pose
from ertis_simulator.room import Room

NOTHING, STAND = "nothing", "stand"
_WALL_GAP_M = 0.25
_APART_M = 0.5  # in range, of a second landmark: out of the first one's fragment
_ASIDE_RAD = np.deg2rad(12.0)  # of what stands nearer than the labelled spot
_CLEAR_M = 0.45  # of things around the sonar
_INSIDE_M = 0.1  # of glints around what is put there
_SIDES_M = tuple(
    np.array([0.0, across, up]) for across in (-0.1, 0.0, 0.1) for up in (-0.1, 0.0, 0.1)
)
_TRIES = 400


class Limits(Protocol):
    """Spans that spots are drawn from; angles in degrees, to either side."""

    @property
    def range_m(self) -> tuple[float, float]:
        """Low and high."""

    @property
    def azimuth_deg(self) -> tuple[float, float]:
        """Off the sonar's axis."""

    @property
    def yaw_deg(self) -> tuple[float, float]:
        """Of what stands there, away from the sonar."""


@dataclass(frozen=True, slots=True)
class Spot:
    """Where something is put: seen from the sonar, and in the world."""

    range_m: float
    azimuth_rad: float
    yaw_rad: float
    at_m: tuple[float, float, float]
    facing_rad: float

    @classmethod
    def draw(cls, limits: Limits, room: Room, pose: Pose, rng: np.random.Generator) -> Spot:
        """One inside the room; narrow rooms hold fewer of the far and the oblique ones."""
        low, high = limits.range_m
        for attempt in range(_TRIES):
            # Rooms too short for the far end come nearer, bit by bit.
            distance = rng.uniform(low, low + (high - low) * (1 - attempt / _TRIES))
            azimuth = _either_side(limits.azimuth_deg, rng)
            rise = rng.normal(0, 0.05)
            flat = np.sqrt(distance**2 - rise**2)
            bearing = pose.yaw_rad + azimuth
            x = pose.position_m[0] + flat * np.cos(bearing)
            y = pose.position_m[1] + flat * np.sin(bearing)
            if _inside(room, x, y):
                break
        else:
            raise RuntimeError(f"no spot in room {room} for a sonar at {pose}")
        yaw = _either_side(limits.yaw_deg, rng)
        at = (float(x), float(y), float(pose.position_m[2] + rise))
        return cls(float(distance), azimuth, yaw, at, float(bearing + np.pi + yaw))


def _either_side(span_deg: tuple[float, float], rng: np.random.Generator) -> float:
    return float(np.deg2rad(rng.uniform(*span_deg)) * rng.choice([-1.0, 1.0]))


def _inside(room: Room, x: float, y: float) -> bool:
    (x0, x1), (y0, y1) = room.x_m, room.y_m
    gap = _WALL_GAP_M
    return bool(x0 + gap < x < x1 - gap and y0 + gap < y < y1 - gap)


def other_spot(
    limits: Limits, room: Room, pose: Pose, spot: Spot, rng: np.random.Generator
) -> Spot:
    """Another, out of the first one's fragment and not in front of it, if the room allows."""
    other = Spot.draw(limits, room, pose, rng)
    for _ in range(_TRIES):
        behind = other.range_m > spot.range_m
        aside = abs(other.azimuth_rad - spot.azimuth_rad) > _ASIDE_RAD
        if abs(other.range_m - spot.range_m) > _APART_M and (behind or aside):
            break
        other = Spot.draw(limits, room, pose, rng)
    return other


def stand_sonar(place: Place, rng: np.random.Generator) -> Pose:
    """At one end of the room, looking along it."""
    (x0, _), (y0, y1) = place.room.x_m, place.room.y_m
    middle, half = (y0 + y1) / 2, (y1 - y0) / 2 - 0.6
    at = (x0 + rng.uniform(0.4, 0.9), middle + half * rng.uniform(-0.7, 0.7))
    aside = (middle - at[1]) / max(half, 0.1)  # look towards the middle rather than at a wall
    yaw = np.deg2rad(rng.uniform(-8.0, 8.0) + 8.0 * aside)
    return Pose((float(at[0]), float(at[1]), float(rng.uniform(0.5, 1.1))), float(yaw))


def put_landmark(label: str, spot: Spot, rng: np.random.Generator) -> DishObject:
    """Put a landmark at a spot, level but for a hand's error."""
    facing = (spot.facing_rad, float(rng.normal(0, np.deg2rad(2.0))))
    return DishObject(label, Dish.landmark(float(label[1:])), spot.at_m, facing)


def put_something(
    kind: str,
    spot: Spot,
    rng: np.random.Generator,
    dishes: list[DishObject],
    things: list[Thing],
) -> None:
    """Put something that is no landmark at a spot, its front there."""
    x, y, z = spot.at_m
    if kind == NOTHING:
        return
    if kind == STAND:
        things.append(rod(x, y, z))
        return
    given = {"height_m": z}
    if kind in ("pipe", "box", "bush"):
        given = {"base_m": 0.0, "top_m": z + float(rng.uniform(0.1, 0.6))}
    sizes = draw_sizes(kind, given, rng)
    if kind in DISH_KINDS:
        dish_shape = Dish(sizes["radius_m"], sizes["depth_m"])
        dishes.append(DishObject(kind, dish_shape, spot.at_m, (spot.facing_rad, 0.0), False))
        return
    behind = sizes["depth_m"] / 2 if kind == "box" else sizes.get("radius_m", 0.0)
    away = spot.facing_rad - spot.yaw_rad + np.pi
    x, y = x + behind * float(np.cos(away)), y + behind * float(np.sin(away))
    things.append(make_thing(kind, x, y, spot.facing_rad, sizes, rng))


def cleared(clutter: Clutter, spot: Spot) -> Clutter:
    """Clutter without what would be inside the thing put there."""
    keep = np.linalg.norm(clutter.points.positions_m - spot.at_m, axis=1) > _INSIDE_M
    return Clutter(clutter.points.where(keep), clutter.lines, clutter.panels)


def kept_furniture(place: Place, pose: Pose, spot: Spot) -> tuple[Thing, ...]:
    """Furniture that neither stands in the sonar nor before the spot: its user moved the rest."""
    sonar, target = np.asarray(pose.position_m), np.asarray([spot.at_m])
    kept = []
    for thing in place.things:
        near = np.hypot(*(np.asarray(thing.place_m) - sonar)[:2]) < _CLEAR_M
        inside = any(
            blocker.hits(sonar + side, target + side)[0]
            for blocker in thing.blockers
            for side in _SIDES_M
        )
        if not near and not inside:
            kept.append(thing)
    return tuple(kept)
