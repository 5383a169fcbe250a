"""The paper's data set, simulated: 944 pings in seven environments, and harder variants of it.

Which ping has which label, where it was made and what stands there follows from the seed and the
ping's number alone, so that neither order nor the number of workers matters, and a smaller data
set is the beginning of a larger one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ertis_detector.air import Air
from ertis_driver.frame import NUM_MICS
from ertis_simulator.environments import ENVIRONMENTS, Place, draw_place
from ertis_simulator.landmark import RADII_MM
from ertis_simulator.objects import DishObject, Thing
from ertis_simulator.placement import (
    NOTHING,
    STAND,
    Spot,
    cleared,
    kept_furniture,
    other_spot,
    put_landmark,
    put_something,
    stand_sonar,
)
from ertis_simulator.scene import Scene

PAPER_PINGS = 944
NONE = "none"
LABELS = (*(f"r{radius}" for radius in RADII_MM), NONE)
SESSION_PINGS = 27  # five sessions an environment at the paper's size
# What stands where a "none" ping's label points, with equal shares; a stand is a rod without dish.
NONE_KINDS = (
    NOTHING,
    STAND,
    "pipe",
    "box",
    "bush",
    "bowl",
    "lampshade",
    "dihedral",
    "trihedral",
)
CONCAVE_KINDS = ("bowl", "lampshade", "dihedral", "trihedral")


@dataclass(frozen=True, slots=True)
class Variant:
    """How a data set differs from the paper's; angles in degrees, as its user sees them.

    about : one line
    range_m, azimuth_deg, yaw_deg : (low, high); angles to either side
    num_landmarks : in each labelled ping; the first is the labelled one
    num_decoys : concave things beside whatever is labelled
    temperatures_c : spans in place of the environment's own
    room_series : rooms drawn anew for another number
    dead_mics : (fewest, most)
    """

    about: str
    range_m: tuple[float, float] = (0.6, 4.2)
    azimuth_deg: tuple[float, float] = (0.0, 20.0)
    yaw_deg: tuple[float, float] = (0.0, 30.0)
    num_landmarks: int = 1
    num_decoys: int = 0
    temperatures_c: tuple[tuple[float, float], ...] = ()
    room_series: int = 0
    dead_mics: tuple[int, int] = (0, 0)


VARIANTS: Mapping[str, Variant] = {
    "paper": Variant("as the paper: one landmark or none, 0.6 to 4.2 m"),
    "turned": Variant("landmark turned 30 to 60 degrees", yaw_deg=(30.0, 60.0)),
    "two": Variant("a second landmark elsewhere in the ping", num_landmarks=2),
    "decoys": Variant("two concave decoys in the ping, one more in place of none", num_decoys=2),
    "far": Variant("0.6 to 6 m", range_m=(0.6, 6.0)),
    "off-axis": Variant("20 to 60 degrees off the axis", azimuth_deg=(20.0, 60.0)),
    "temperature": Variant("-5 to 5 or 30 to 40 degrees C", temperatures_c=((-5, 5), (30, 40))),
    "unseen-rooms": Variant("other rooms of the same kinds", room_series=1),
    "dead-mics": Variant("2 to 8 dead microphones, others each session", dead_mics=(2, 8)),
}


@dataclass(frozen=True, slots=True)
class PlannedPing:
    """One ping of a data set, before it is made."""

    number: int
    label: str
    environment: str
    session: int
    position: int

    @property
    def file_name(self) -> str:
        """Relative to the data set's folder."""
        name = f"{self.position:04d}_{self.label}.mcap"
        return f"{self.environment}/{self.session_name}/{name}"

    @property
    def session_name(self) -> str:
        """``s1`` and so on."""
        return f"s{self.session}"


@dataclass(frozen=True, slots=True, eq=False)
class LabelledScene:
    """A ping's world, and where its label points.

    range_m : to the vertex of the landmark, or to where one would be
    azimuth_rad : of the same
    yaw_rad : of the landmark's opening away from the sonar, + left; NaN for none
    """

    scene: Scene
    range_m: float
    azimuth_rad: float
    yaw_rad: float


def plan(num_pings: int = PAPER_PINGS) -> list[PlannedPing]:
    """Deal pings out to environments and labels, evenly."""
    names = list(ENVIRONMENTS)
    pings = []
    for number in range(num_pings):
        turn, which = divmod(number, len(names))
        session, position = divmod(turn, SESSION_PINGS)
        label = LABELS[(turn + which) % len(LABELS)]
        pings.append(PlannedPing(number, label, names[which], session + 1, position + 1))
    return pings


def build_scene(seed: int, ping: PlannedPing, variant: Variant) -> LabelledScene:
    """Furnish the room, put the sonar where its session has it, then what the label says.

    One sonar makes the whole data set: its microphones are those of the seed.
    """
    which = list(ENVIRONMENTS).index(ping.environment)
    place = _place(seed, ping.environment, variant.room_series)
    session_rng = np.random.default_rng([seed, 2, which, ping.session])
    pose = stand_sonar(place, session_rng)
    dead = _dead_mics(variant, session_rng)
    rng = np.random.default_rng([seed, 3, ping.number])
    spot = Spot.draw(variant, place.room, pose, rng)
    dishes, things = _labelled(ping.label, spot, variant, rng)
    if variant.num_landmarks > 1:
        others = [label for label in LABELS[:-1] if label != ping.label]
        other = other_spot(variant, place.room, pose, spot, rng)
        dishes.append(put_landmark(str(rng.choice(others)), other, rng))
    for _ in range(variant.num_decoys):
        decoy_spot = other_spot(variant, place.room, pose, spot, rng)
        put_something(str(rng.choice(CONCAVE_KINDS)), decoy_spot, rng, dishes, things)
    scene = Scene(
        room=place.room,
        start=pose,
        dishes=tuple(dishes),
        clutter=cleared(place.clutter, spot),
        air=_air(place.air, variant, rng),
        seed=seed,
        name=f"{ping.environment}/{ping.session_name}",
        things=(*kept_furniture(place, pose, spot), *things),
        stands=True,
        noise=place.noise,
        dead_mics=dead,
    )
    yaw = spot.yaw_rad if ping.label != NONE else float("nan")
    return LabelledScene(scene, spot.range_m, spot.azimuth_rad, yaw)


@lru_cache(maxsize=len(ENVIRONMENTS))  # furnishing a room takes as long as hearing a ping in it
def _place(seed: int, environment: str, series: int) -> Place:
    which = list(ENVIRONMENTS).index(environment)
    rng = np.random.default_rng([seed, 1, which, series])
    return draw_place(ENVIRONMENTS[environment], rng)


def _dead_mics(variant: Variant, rng: np.random.Generator) -> tuple[int, ...]:
    count = int(rng.integers(variant.dead_mics[0], variant.dead_mics[1] + 1))
    return tuple(sorted(int(mic) for mic in rng.choice(NUM_MICS, count, replace=False)))


def _air(own: Air, variant: Variant, rng: np.random.Generator) -> Air:
    if not variant.temperatures_c:
        return Air(own.temperature_c + float(rng.normal(0, 0.5)), own.humidity_percent)
    low, high = variant.temperatures_c[int(rng.integers(len(variant.temperatures_c)))]
    return Air(float(rng.uniform(low, high)), own.humidity_percent)


def _labelled(
    label: str, spot: Spot, variant: Variant, rng: np.random.Generator
) -> tuple[list[DishObject], list[Thing]]:
    dishes: list[DishObject] = []
    things: list[Thing] = []
    if label != NONE:
        dishes.append(put_landmark(label, spot, rng))
    else:
        put_something(
            str(rng.choice(CONCAVE_KINDS if variant.num_decoys else NONE_KINDS)),
            spot,
            rng,
            dishes,
            things,
        )
    return dishes, things
