"""The ways by which a dish is heard, directly and by the floor, and what stands in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.landmark import dish_echoes
from ertis_simulator.objects import DishObject, Thing
from ertis_simulator.occlusion import Blocker, clear_part
from ertis_simulator.path import Pose
from ertis_simulator.room import Room

FloatArray = npt.NDArray[np.float64]

_MIRROR = np.array([1.0, 1.0, -1.0])  # the floor's


@dataclass(frozen=True, slots=True, eq=False)
class Shadows:
    """What may hide a dish at one moment: objects with a footprint, and other dishes.

    blockers : tuple of (DishObject or None, Blocker)
        The dish that each one is, if it is one.
    """

    time_s: float
    blockers: tuple[tuple[DishObject | None, Blocker], ...]

    @classmethod
    def at(cls, things: Sequence[Thing], dishes: Sequence[DishObject], time_s: float) -> Shadows:
        """Move everything to where it is at a time."""
        blockers: list[tuple[DishObject | None, Blocker]] = []
        for thing in things:
            if thing.blockers:
                offset = thing.offset_m(time_s)
                blockers.extend((None, blocker.shifted(offset)) for blocker in thing.blockers)
        for item in dishes:
            x, y, z = item.vertex_at(time_s)
            radius = item.dish.aperture_radius_m
            # Seen from above, a dish is a disc as wide as its aperture, whichever way it looks.
            disc = Blocker.cylinder(x, y, radius, z - radius, z + radius)
            blockers.append((item, disc))
        return cls(time_s, tuple(blockers))

    def clear_part(self, item: DishObject, sonar_m: FloatArray) -> float:
        """Part of a dish that a sonar at ``sonar_m`` (3,), world frame, sees: 0 to 1."""
        axis = item.axis
        rim = item.vertex_at(self.time_s) + item.dish.depth_m * axis
        others = [blocker for owner, blocker in self.blockers if owner is not item]
        return clear_part(sonar_m, rim, axis, item.dish.aperture_radius_m, others)


def dish_ways(
    item: DishObject,
    vertex_m: FloatArray,
    pose: Pose,
    room: Room,
    emitter: FloatArray,
    mics: FloatArray,
    clear: float,
    *,
    by_floor: bool = True,
) -> list[Echoes]:
    """Hear a dish directly, and by way of the floor there, back, and both.

    Parameters
    ----------
    item : DishObject
    vertex_m : shape (3,)
        Where it is now, world frame.
    pose : Pose
        Of the sonar.
    emitter, mics : shape (3,) and (num_mics, 3)
        Sensor frame.
    clear : float
        Part of it that is seen. What stands on the floor hides those ways too.

    Returns
    -------
    list of Echoes
        The direct way first; none if nothing of it is seen.
    """
    if clear == 0:
        return []
    vertex, axis = pose.to_sensor(vertex_m), pose.turn(item.axis)
    lift = np.array([0.0, 0.0, -2 * pose.position_m[2]])
    sources, hearers = [emitter], [mics]
    if room.floor_reflection > 0 and by_floor:
        sources.append(emitter * _MIRROR + lift)
        hearers.append(mics * _MIRROR + lift)
    parts = []
    for from_floor, source in enumerate(sources):
        leaving = vertex - source
        sin_emission = _sin_off_axis(leaving)
        grazing = abs(leaving[2]) / np.linalg.norm(leaving)
        for to_floor, heard in enumerate(hearers):
            bounces = from_floor + to_floor
            echoes = dish_echoes(
                item.dish, axis, vertex, source, heard, rim_strength=item.rim_strength
            )
            parts.append(
                echoes.emitted(
                    sin_emission,
                    factor=clear * room.floor_reflection**bounces,
                    roughness_m=bounces * room.floor_roughness_m * grazing,
                )
            )
    return parts


def _sin_off_axis(direction: FloatArray) -> float:
    """Sine of the angle off the emitter's axis (x); 1 for anything backward."""
    if direction[0] <= 0:
        return 1.0
    return float(np.hypot(direction[1], direction[2]) / np.linalg.norm(direction))
