"""A room: floor and walls as specular, slightly rough reflectors, and a weak diffuse field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.points import REFERENCE_K

FloatArray = npt.NDArray[np.float64]
_Map = Callable[[FloatArray], FloatArray]
_Walls = list[tuple[FloatArray, FloatArray]]  # point and inward normal of each

HEIGHT_M = 3.0  # assumed: the ceiling is only in the diffuse field
# Of the energy of a piston of 13 mm at 50 kHz, D**2 over all directions: 1 / (k a)**2.
_BEAM_SHARE = 1 / (REFERENCE_K * 0.013) ** 2
_DIFFUSE_ARRIVALS = 160
_DIFFUSE_START_M, _DIFFUSE_STOP_M = 2.0, 13.0  # path lengths: 36 ms of listening
_SCATTER_M = 0.02  # some wavelengths: the field differs from microphone to microphone


class _Image(NamedTuple):
    """Of the emitter, sensor frame: columns of what :class:`Echoes` asks for."""

    source_m: FloatArray
    kept: float
    sin_emission: float
    roughness_m: float


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangular room, its walls along the world's axes; no ceiling.

    x_m, y_m : (low, high)
        Walls. An infinite bound is no wall.
    wall_reflection, floor_reflection : float
        Amplitude kept at a bounce; 0 for none.
    wall_roughness_m, floor_roughness_m : float
        RMS height of the surface: assumed.
    diffuse : float
        Amplitude of the reverberation against the ideal diffuse field of the room: assumed.
    """

    x_m: tuple[float, float] = (-2.0, 5.0)
    y_m: tuple[float, float] = (-3.0, 3.0)
    wall_reflection: float = 0.8
    floor_reflection: float = 0.7
    wall_roughness_m: float = 0.3e-3
    floor_roughness_m: float = 0.5e-3
    diffuse: float = 0.3

    def planes(self) -> _Walls:
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
        """Specular echoes of walls and corners, each also by way of the floor; [] for none.

        Parameters
        ----------
        to_sensor, turn
            World points, and directions, to the sensor frame.
        emitter, mics : shape (3,) and (num_mics, 3)
        """
        floor_z = to_sensor(np.zeros(3))[2]
        sides = [(to_sensor(point), turn(normal)) for point, normal in self.planes()]
        middle = mics.mean(axis=0)
        images: list[_Image] = []
        for first in sides:
            paths = [[first]]
            paths.extend([first, second] for second in sides if abs(first[1] @ second[1]) < 0.5)
            for path in paths:
                images.extend(self._images(path, emitter, middle, floor_z))
        if not images:
            return []
        source, kept, sine, roughness = (np.array(column) for column in zip(*images, strict=True))
        distance = np.linalg.norm(mics - source[:, None], axis=2)
        gain = kept[:, None] / distance
        exponent = np.zeros(len(images))
        return [Echoes(distance, gain, exponent, sine, roughness)]

    def _images(
        self, path: _Walls, emitter: FloatArray, middle: FloatArray, floor_z: float
    ) -> Iterator[_Image]:
        """The last-bounce image of the emitter, heard by the array's middle; and its mirror."""
        image = emitter
        for point, normal in path:
            image = image - 2 * ((image - point) @ normal) * normal
        images = [(image, 1.0, 0.0)]
        if self.floor_reflection > 0:
            under = image * np.array([1.0, 1.0, -1.0]) + np.array([0.0, 0.0, 2 * floor_z])
            images.append((under, self.floor_reflection, self.floor_roughness_m))
        for source, kept, roughness in images:
            # Reflected back at each wall in turn, the direction of arrival is that of emission.
            leaving = middle - source
            for _, normal in reversed(path):
                leaving = leaving - 2 * (leaving @ normal) * normal
            sine = np.hypot(leaving[1], leaving[2]) / np.linalg.norm(leaving)
            yield _Image(
                source,
                kept * self.wall_reflection ** len(path),
                float(sine) if leaving[0] > 0 else 1.0,
                self.wall_roughness_m * len(path) + roughness,
            )

    def reverberation(self, num_mics: int, rng: np.random.Generator) -> Echoes | None:
        """Sound that has met many things, from everywhere; none in a room without end.

        In the ideal diffuse field, image sources arrive at 4 pi c^3 t^2 / V a second, each with
        1 / (c t): together 4 pi c / V a second of squared amplitude re 1 m, of which the emitter's
        beam gives its share and each mean free path (4 V / S) keeps the walls' reflection.
        """
        wide, deep = self.x_m[1] - self.x_m[0], self.y_m[1] - self.y_m[0]
        if self.diffuse == 0 or not np.isfinite(wide * deep):
            return None
        volume = wide * deep * HEIGHT_M
        free_path = 4 * volume / (2 * (wide * deep + (wide + deep) * HEIGHT_M))
        path = rng.uniform(_DIFFUSE_START_M, _DIFFUSE_STOP_M, _DIFFUSE_ARRIVALS)
        spacing = (_DIFFUSE_STOP_M - _DIFFUSE_START_M) / _DIFFUSE_ARRIVALS
        kept = self.wall_reflection ** (path / free_path)
        rms = self.diffuse * np.sqrt(4 * np.pi / volume * _BEAM_SHARE * spacing) * kept
        shape = (_DIFFUSE_ARRIVALS, num_mics)
        return Echoes.of(
            path[:, None] + rng.normal(0, _SCATTER_M, shape),
            REFERENCE_K * rms[:, None] * rng.standard_normal(shape),
            exponent=-1.0,  # the beam narrows as k, its share of the energy as k squared
        )
