"""Seven environments in the spirit of the paper's, each a distribution of rooms. All ASSUMED.

The paper names two ends, open lab and packed garage, and no figure. What is drawn here: size,
walls, floor, furniture, small things by kind, noise and air. The same as a
table: ``docs/environments.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ertis_detector.air import Air
from ertis_simulator.clutter import EVEN, Clutter
from ertis_simulator.noise_sources import AirGun, NoiseSource, OtherSonar, Tone
from ertis_simulator.objects import Thing, draw_sizes, make_thing
from ertis_simulator.room import Room

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Environment:
    """One kind of place; spans are (low, high), drawn uniformly.

    width_m, length_m : of the room
    clutter_per_m2 : small things (clusters of glints) a square metre
    kinds : how common each kind of small thing is
    furniture_per_m2 : expected number of each named object a square metre
    machine_probability : of a whining machine
    air_gun_probability, sonar_probability : of an air gun, of another sonar
    """

    width_m: Span
    length_m: Span
    clutter_per_m2: Span
    wall_reflection: Span = (0.6, 0.9)
    wall_roughness_m: Span = (0.1e-3, 0.6e-3)
    floor_reflection: Span = (0.5, 0.9)
    floor_roughness_m: Span = (0.2e-3, 0.8e-3)
    diffuse: Span = (0.1, 0.4)
    kinds: Mapping[str, float] = field(default_factory=lambda: EVEN)
    furniture_per_m2: Mapping[str, float] = field(default_factory=dict)
    temperature_c: Span = (18.0, 24.0)
    humidity_percent: Span = (35.0, 60.0)
    machine_probability: float = 0.1
    air_gun_probability: float = 0.0
    sonar_probability: float = 0.0


ENVIRONMENTS: Mapping[str, Environment] = {
    "open_lab": Environment(
        (7.0, 10.0), (8.0, 12.0), (0.5, 0.8), furniture_per_m2={"box": 0.02, "pipe": 0.03}
    ),
    "office": Environment(
        (4.0, 6.0),
        (5.0, 7.0),
        (1.0, 2.0),
        floor_reflection=(0.2, 0.5),  # carpet
        floor_roughness_m=(0.6e-3, 1.5e-3),
        kinds={"edge": 3.0, "pipe": 2.0, "bush": 0.5, "box": 2.0, "concave": 1.0},
        furniture_per_m2={"box": 0.12, "pipe": 0.2, "edge": 0.1},
        machine_probability=0.3,
    ),
    "corridor": Environment(
        (1.8, 2.6),
        (10.0, 20.0),
        (0.5, 1.0),
        wall_reflection=(0.8, 0.95),
        wall_roughness_m=(0.05e-3, 0.3e-3),
        floor_reflection=(0.8, 0.95),
        diffuse=(0.2, 0.5),
        kinds={"edge": 3.0, "pipe": 1.0, "bush": 0.2, "box": 1.0, "concave": 0.5},
        furniture_per_m2={"edge": 0.15, "pipe": 0.05},
    ),
    "living_room": Environment(
        (4.0, 6.0),
        (5.0, 7.0),
        (1.5, 3.0),
        wall_reflection=(0.5, 0.8),
        floor_reflection=(0.2, 0.6),
        floor_roughness_m=(0.5e-3, 1.5e-3),
        kinds={"edge": 1.0, "pipe": 1.0, "bush": 3.0, "box": 1.0, "concave": 1.0},
        furniture_per_m2={"bush": 0.08, "box": 0.1, "pipe": 0.1},
    ),
    "workshop": Environment(
        (5.0, 8.0),
        (6.0, 10.0),
        (2.0, 4.0),
        kinds={"edge": 2.0, "pipe": 3.0, "bush": 0.3, "box": 2.0, "concave": 2.0},
        furniture_per_m2={"box": 0.1, "pipe": 0.2, "trihedral": 0.05, "dihedral": 0.05},
        temperature_c=(14.0, 24.0),
        machine_probability=0.8,
        air_gun_probability=0.4,
    ),
    "greenhouse": Environment(
        (4.0, 8.0),
        (6.0, 12.0),
        (3.0, 5.0),
        wall_roughness_m=(0.05e-3, 0.2e-3),  # glass
        floor_reflection=(0.3, 0.6),
        floor_roughness_m=(1.0e-3, 2.0e-3),
        kinds={"edge": 0.5, "pipe": 1.0, "bush": 6.0, "box": 0.5, "concave": 0.5},
        furniture_per_m2={"bush": 0.3, "pipe": 0.15},
        temperature_c=(20.0, 32.0),
        humidity_percent=(60.0, 90.0),
    ),
    "packed_garage": Environment(
        (3.0, 4.5),
        (5.5, 7.5),
        (5.0, 8.0),
        wall_roughness_m=(0.3e-3, 1.0e-3),
        kinds={"edge": 2.0, "pipe": 2.0, "bush": 1.0, "box": 3.0, "concave": 2.0},
        furniture_per_m2={"box": 0.25, "pipe": 0.2, "edge": 0.1, "dihedral": 0.08},
        temperature_c=(8.0, 20.0),
        humidity_percent=(40.0, 75.0),
        machine_probability=0.2,
        sonar_probability=0.2,
    ),
}


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """One room of an environment, furnished; the origin is its south-west corner.

    things : furniture; what stands where the sonar looks is taken out by whoever puts it there
    """

    room: Room
    clutter: Clutter
    things: tuple[Thing, ...]
    air: Air
    noise: tuple[NoiseSource, ...]


def draw_place(environment: Environment, rng: np.random.Generator) -> Place:
    """One room of an environment."""
    room = Room(
        (0.0, _draw(environment.length_m, rng)),
        (0.0, _draw(environment.width_m, rng)),
        _draw(environment.wall_reflection, rng),
        _draw(environment.floor_reflection, rng),
        _draw(environment.wall_roughness_m, rng),
        _draw(environment.floor_roughness_m, rng),
        _draw(environment.diffuse, rng),
    )
    density = _draw(environment.clutter_per_m2, rng)
    return Place(
        room,
        Clutter.scatter(room.x_m, room.y_m, density, rng, weights=environment.kinds),
        _furniture(environment, room, rng),
        Air(_draw(environment.temperature_c, rng), _draw(environment.humidity_percent, rng)),
        _noise(environment, rng),
    )


def _draw(span: Span, rng: np.random.Generator) -> float:
    return float(rng.uniform(*span))


def _furniture(environment: Environment, room: Room, rng: np.random.Generator) -> tuple[Thing, ...]:
    area = (room.x_m[1] - room.x_m[0]) * (room.y_m[1] - room.y_m[0])
    things = []
    for kind, per_m2 in environment.furniture_per_m2.items():
        for _ in range(rng.poisson(per_m2 * area)):
            x, y = rng.uniform(*room.x_m), rng.uniform(*room.y_m)
            facing = rng.uniform(-np.pi, np.pi)
            if kind == "box":  # along the walls' directions, as furniture mostly is
                facing = rng.integers(4) * np.pi / 2 + rng.normal(0, np.deg2rad(4.0))
            sizes = draw_sizes(kind, {}, rng)
            things.append(make_thing(kind, float(x), float(y), float(facing), sizes, rng))
    return tuple(things)


def _noise(environment: Environment, rng: np.random.Generator) -> tuple[NoiseSource, ...]:
    """Who makes noise there; levels are ASSUMED, from just audible to a nuisance."""
    sources: list[NoiseSource] = []
    if rng.random() < environment.machine_probability:
        tone_hz, level = rng.uniform(8e3, 45e3), rng.uniform(-75.0, -50.0)
        sources.append(Tone(float(tone_hz), float(level), float(rng.uniform(-np.pi, np.pi))))
    if rng.random() < environment.air_gun_probability:
        level, azimuth = rng.uniform(-70.0, -45.0), rng.uniform(-np.pi, np.pi)
        sources.append(AirGun(float(level), azimuth_rad=float(azimuth)))
    if rng.random() < environment.sonar_probability:
        level, azimuth = rng.uniform(-70.0, -45.0), rng.uniform(-np.pi, np.pi)
        sources.append(OtherSonar(float(level), azimuth_rad=float(azimuth)))
    return tuple(sources)
