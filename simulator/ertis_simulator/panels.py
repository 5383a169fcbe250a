"""Panels: the flat faces of boxes, which mirror the emitter while they are wide enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.path import Pose

FloatArray = npt.NDArray[np.float64]

REFLECTION = 0.8  # assumed, as of a wall: wood, metal and plastic are all hard to air
ROUGHNESS_M = 0.2e-3  # assumed
_WAVELENGTH_M = 343.0 / 50e3


@dataclass(frozen=True, slots=True, eq=False)
class Panels:
    """Upright rectangles in the world.

    centre_m : shape (n, 3)
    facing_rad : shape (n,)
        Azimuth of the outward normal; the normal is level.
    half_m : shape (n, 2)
        Half the width, half the height.
    """

    centre_m: FloatArray
    facing_rad: FloatArray
    half_m: FloatArray

    @classmethod
    def none(cls) -> Panels:
        """No panel at all."""
        return cls(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)))

    @classmethod
    def join(cls, parts: list[Panels]) -> Panels:
        """All panels of all parts."""
        return cls(
            np.concatenate([part.centre_m for part in parts]),
            np.concatenate([part.facing_rad for part in parts]),
            np.concatenate([part.half_m for part in parts]),
        )

    def shifted(self, offset_m: FloatArray) -> Panels:
        """The same panels elsewhere."""
        return Panels(self.centre_m + offset_m, self.facing_rad, self.half_m)

    def echoes(self, pose: Pose, emitter: FloatArray, mics: FloatArray) -> Echoes:
        """Their mirror images; emitter (3,) and mics (num_mics, 3) in the sensor frame.

        The image fades over a Fresnel zone as its mirror point leaves the rectangle.
        """
        zero = np.zeros_like(self.facing_rad)
        normal = pose.turn(np.stack([np.cos(self.facing_rad), np.sin(self.facing_rad), zero], 1))
        across = np.stack([-normal[:, 1], normal[:, 0], zero], axis=1)
        centre = pose.to_sensor(self.centre_m)
        height = np.einsum("nk,nk->n", emitter - centre, normal)
        image = emitter - 2 * height[:, None] * normal
        way = mics.mean(axis=0) - image
        mirror = image + way / 2  # half-way: emitter and microphones are equally far from it
        off = mirror - centre
        place = np.stack([np.einsum("nk,nk->n", off, across), off[:, 2]], axis=1)
        zone = np.sqrt(_WAVELENGTH_M * np.maximum(np.abs(height), 0.1) / 4)[:, None]
        inside = np.clip((self.half_m - np.abs(place)) / zone, -30, 30)
        seen = np.prod(1 / (1 + np.exp(-2 * inside)), axis=1) * (height > 0)
        distance = np.maximum(np.linalg.norm(mics[None] - image[:, None], axis=2), 0.1)
        leaving = mirror - emitter
        span = np.maximum(np.linalg.norm(leaving, axis=1), 1e-9)
        sine = np.hypot(leaving[:, 1], leaving[:, 2]) / span
        return Echoes.of(
            distance,
            REFLECTION * seen[:, None] / distance,
            sin_emission=np.where(leaving[:, 0] > 0, sine, 1.0),
            roughness_m=ROUGHNESS_M,
        )
