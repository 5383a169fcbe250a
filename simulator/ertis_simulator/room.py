"""A room: floor and walls as specular, slightly rough reflectors (image sources)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes

FloatArray = npt.NDArray[np.float64]
_Map = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangular room, its walls along the world's axes; no ceiling.

    x_m, y_m : (low, high)
        Walls. An infinite bound is no wall.
    wall_reflection, floor_reflection : float
        Amplitude kept at a bounce; 0 for none.
    wall_roughness_m, floor_roughness_m : float
        RMS height of the surface: assumed.
    """

    x_m: tuple[float, float] = (-2.0, 5.0)
    y_m: tuple[float, float] = (-3.0, 3.0)
    wall_reflection: float = 0.8
    floor_reflection: float = 0.7
    wall_roughness_m: float = 0.3e-3
    floor_roughness_m: float = 0.5e-3

    def planes(self) -> list[tuple[FloatArray, FloatArray]]:
        """Point and inward normal of each wall, world frame."""
        x0, x1 = self.x_m
        y0, y1 = self.y_m
        walls = [
            ((x0, 0.0, 0.0), (1.0, 0.0, 0.0)),
            ((x1, 0.0, 0.0), (-1.0, 0.0, 0.0)),
            ((0.0, y0, 0.0), (0.0, 1.0, 0.0)),
            ((0.0, y1, 0.0), (0.0, -1.0, 0.0)),
        ]
        return [(np.array(p), np.array(n)) for p, n in walls if np.isfinite(p).all()]

    def echoes(
        self, to_sensor: _Map, turn: _Map, emitter: FloatArray, mics: FloatArray
    ) -> list[Echoes]:
        """Specular echoes of walls and corners, each also by way of the floor.

        Parameters
        ----------
        to_sensor, turn
            World points, and directions, to the sensor frame.
        emitter, mics : shape (3,) and (num_mics, 3)
        """
        floor = to_sensor(np.zeros(3))[2]
        sides = [(to_sensor(point), turn(normal)) for point, normal in self.planes()]
        parts = []
        for first in sides:
            paths = [[first]]
            paths.extend([first, second] for second in sides if abs(first[1] @ second[1]) < 0.5)
            for path in paths:
                parts.extend(self._image(path, emitter, mics, floor))
        return parts

    def _image(
        self,
        path: list[tuple[FloatArray, FloatArray]],
        emitter: FloatArray,
        mics: FloatArray,
        floor_z: float,
    ) -> list[Echoes]:
        """The last-bounce image of the emitter, seen by the microphones; and under the floor."""
        image = emitter
        for point, normal in path:
            image = image - 2 * ((image - point) @ normal) * normal
        images = [(image, 1.0, 0.0)]
        if self.floor_reflection > 0:
            under = image * np.array([1.0, 1.0, -1.0]) + np.array([0.0, 0.0, 2 * floor_z])
            images.append((under, self.floor_reflection, self.floor_roughness_m))
        heard = []
        for source, kept, roughness in images:
            # Reflected back at each wall in turn, the direction of arrival is that of emission.
            leaving = mics.mean(axis=0) - source
            for _, normal in reversed(path):
                leaving = leaving - 2 * (leaving @ normal) * normal
            sine = np.hypot(leaving[1], leaving[2]) / np.linalg.norm(leaving)
            distance = np.linalg.norm(mics - source, axis=1)
            heard.append(
                Echoes.of(
                    distance,
                    kept * self.wall_reflection ** len(path) / distance,
                    sin_emission=float(sine) if leaving[0] > 0 else 1.0,
                    roughness_m=self.wall_roughness_m * len(path) + roughness,
                )
            )
        return heard
