"""Random scenes for training: rooms, clutter, landmarks, decoys; all drawn from one seed."""

from __future__ import annotations

import numpy as np

from ertis_detector.air import Air
from ertis_simulator.clutter import CLUSTER_KINDS, Clutter
from ertis_simulator.landmark import RADII_MM, Dish
from ertis_simulator.noise_sources import AirGun, NoiseSource, OtherSonar, Tone
from ertis_simulator.objects import DISH_KINDS, SIZES, DishObject, Thing, draw_sizes, make_thing
from ertis_simulator.path import Pose
from ertis_simulator.room import Room
from ertis_simulator.scene import Scene

# The paper's span of rooms, open lab to packed garage: things a square metre (see docs/decisions).
CLUTTER_PER_M2 = (0.5, 8.0)
RANGE_M = (0.6, 6.0)
MAX_AZIMUTH_RAD = np.deg2rad(30.0)
WIDE_SHARE, WIDE_AZIMUTH_RAD = 0.2, np.deg2rad(60.0)
HIGH_SHARE, HIGH_ELEVATION_RAD = 0.2, np.deg2rad(20.0)  # others hang about as high as the sonar
WALL_GAP_M = 0.2
MAX_TURN_RAD = np.deg2rad(50.0)  # of a dish away from the sonar
STANDS_SHARE, NOISY_SHARE = 0.7, 0.25
_THING_KINDS = tuple(kind for kind in SIZES if kind not in DISH_KINDS)
_MEAN_THINGS = 3.0
_CLEAR_M = 0.5  # nothing stands nearer to the sonar


def random_scene(seed: int, number: int) -> Scene:
    """Scene ``number`` of the data set that ``seed`` names.

    Three in four hold one to three landmarks; decoys (bowls and lampshades of other shapes) stand
    in half, three other objects on average in each, any of which may hide a dish.
    """
    rng = np.random.default_rng([seed, number])
    room = _room(rng)
    height = rng.uniform(0.3, 1.2)
    dishes: list[DishObject] = []
    if rng.random() < 0.75:
        for _ in range(rng.integers(1, 4)):
            radius_mm = int(rng.choice(RADII_MM))
            dish = Dish.landmark(radius_mm)
            dishes.append(_stand(f"r{radius_mm}", dish, True, height, room, rng))
    if rng.random() < 0.5:
        for _ in range(rng.integers(1, 3)):
            kind = str(rng.choice(DISH_KINDS))
            sizes = draw_sizes(kind, {}, rng)
            dish = Dish(sizes["radius_m"], sizes["depth_m"])
            dishes.append(_stand(kind, dish, False, height, room, rng))
    weights = dict(zip(CLUSTER_KINDS, rng.dirichlet(np.ones(len(CLUSTER_KINDS))), strict=True))
    density = float(rng.uniform(*CLUTTER_PER_M2))
    return Scene(
        room=room,
        start=Pose((0.0, 0.0, height), rng.uniform(-0.3, 0.3)),
        dishes=tuple(dishes),
        clutter=Clutter.scatter(room.x_m, room.y_m, density, rng, weights=weights),
        air=Air(rng.uniform(-10.0, 40.0), rng.uniform(20.0, 90.0)),
        seed=int(rng.integers(2**31)),
        name=f"random {seed}/{number}",
        things=_things(room, rng),
        stands=bool(rng.random() < STANDS_SHARE),
        noise=_noise(rng),
    )


def _room(rng: np.random.Generator) -> Room:
    ahead, behind = rng.uniform(3.0, 7.0), rng.uniform(0.5, 3.0)
    left, right = rng.uniform(1.2, 4.0, 2)
    return Room(
        (-behind, ahead),
        (-right, left),
        wall_reflection=rng.uniform(0.4, 0.95),
        floor_reflection=rng.uniform(0.3, 0.9),
        wall_roughness_m=rng.uniform(0.1e-3, 1.0e-3),
        floor_roughness_m=rng.uniform(0.2e-3, 1.5e-3),
        diffuse=rng.uniform(0.1, 0.5),
    )


def _stand(
    label: str,
    dish: Dish,
    is_landmark: bool,
    height_m: float,
    room: Room,
    rng: np.random.Generator,
) -> DishObject:
    """A dish in front of the sonar (at the origin), turned somewhat away from it."""
    while True:
        distance = rng.uniform(*RANGE_M)
        widest = WIDE_AZIMUTH_RAD if rng.random() < WIDE_SHARE else MAX_AZIMUTH_RAD
        azimuth = rng.uniform(-widest, widest)
        x, y = distance * np.cos(azimuth), distance * np.sin(azimuth)
        if (
            x < room.x_m[1] - WALL_GAP_M
            and room.y_m[0] < y - WALL_GAP_M < y + WALL_GAP_M < room.y_m[1]
        ):
            break
    turn = rng.triangular(-MAX_TURN_RAD, 0.0, MAX_TURN_RAD)
    if rng.random() < HIGH_SHARE:
        rise = distance * np.tan(rng.uniform(-HIGH_ELEVATION_RAD, HIGH_ELEVATION_RAD))
    else:
        rise = rng.normal(0, 0.06)
    vertex = (float(x), float(y), float(max(height_m + rise, 0.1)))
    facing = (float(azimuth + np.pi + turn), float(rng.normal(0, np.deg2rad(6.0))))
    return DishObject(label, dish, vertex, facing, is_landmark)


def _things(room: Room, rng: np.random.Generator) -> tuple[Thing, ...]:
    things = []
    for _ in range(rng.poisson(_MEAN_THINGS)):
        kind = str(rng.choice(_THING_KINDS))
        x, y = float(rng.uniform(*room.x_m)), float(rng.uniform(*room.y_m))
        facing = float(rng.uniform(-np.pi, np.pi))
        sizes = draw_sizes(kind, {}, rng)
        if np.hypot(x, y) - sizes.get("width_m", 0.0) > _CLEAR_M:
            things.append(make_thing(kind, x, y, facing, sizes, rng))
    return tuple(things)


def _noise(rng: np.random.Generator) -> tuple[NoiseSource, ...]:
    if rng.random() >= NOISY_SHARE:
        return ()
    level, azimuth = float(rng.uniform(-75.0, -45.0)), float(rng.uniform(-np.pi, np.pi))
    kind = rng.integers(3)
    if kind == 0:
        return (Tone(float(rng.uniform(8e3, 45e3)), level, azimuth),)
    return (
        AirGun(level, azimuth_rad=azimuth) if kind == 1 else OtherSonar(level, azimuth_rad=azimuth),
    )
