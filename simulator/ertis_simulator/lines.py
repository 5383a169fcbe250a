"""Straight things: pipes and edges, which return their echo from the point nearest to the sonar.

A pipe of radius b (any frequency, k b >> 1) returns r/2 sqrt(b / (r + b)) as a scattering length,
exactly as the geometrical acoustics of a cylinder has it. An edge diffracts: Keller's coefficient
falls with sqrt(k), and a line of it spreads as a cylinder does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.path import Pose

FloatArray = npt.NDArray[np.float64]

EDGE_COEFFICIENT = 0.4  # assumed: 1 / sqrt(2 pi), Keller's for a wedge in its middle directions
_WAVELENGTH_M = 343.0 / 50e3
_NEAREST_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Segments in the world.

    ends_m : shape (n, 2, 3)
    radius_m : shape (n,)
        Of a pipe; 0 for an edge.
    """

    ends_m: FloatArray
    radius_m: FloatArray

    @classmethod
    def none(cls) -> Lines:
        """No line at all."""
        return cls(np.zeros((0, 2, 3)), np.zeros(0))

    @classmethod
    def join(cls, parts: list[Lines]) -> Lines:
        """All lines of all parts."""
        return cls(
            np.concatenate([part.ends_m for part in parts]),
            np.concatenate([part.radius_m for part in parts]),
        )

    def shifted(self, offset_m: FloatArray) -> Lines:
        """The same lines elsewhere."""
        return Lines(self.ends_m + offset_m, self.radius_m)

    def echoes(self, pose: Pose, emitter: FloatArray, mics: FloatArray) -> Echoes:
        """Their echoes; emitter (3,) and mics (num_mics, 3) in the sensor frame.

        Where the nearest point lies beyond an end, the end answers, the weaker the farther off:
        as one over the distance in Fresnel zones, as any edge of an aperture does.
        """
        ends = pose.to_sensor(self.ends_m)
        start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
        unit = along / length[:, None]
        middle = (emitter + mics) / 2
        foot = np.einsum("lmk,lk->lm", middle[None] - start[:, None], unit)
        on_line = np.clip(foot, 0.0, length[:, None])
        point = start[:, None] + on_line[..., None] * unit[:, None]
        out = point - emitter
        there = np.maximum(np.linalg.norm(out, axis=2), _NEAREST_M)
        back = np.maximum(np.linalg.norm(point - mics, axis=2), _NEAREST_M)
        r = (there + back) / 2
        beyond = np.abs(foot - on_line) / np.sqrt(_WAVELENGTH_M * r / 4)
        radius = self.radius_m[:, None]
        pipe = r / 2 * np.sqrt(radius / (r + radius))
        edge = EDGE_COEFFICIENT * np.sqrt(r / 2)
        strength = np.where(radius > 0, pipe, edge) / (1 + beyond)
        mean = out.mean(axis=1)
        sine = np.hypot(mean[:, 1], mean[:, 2]) / np.maximum(np.linalg.norm(mean, axis=1), 1e-9)
        return Echoes.of(
            there + back - 2 * radius,
            strength / r**2,
            exponent=np.where(self.radius_m > 0, 0.0, -0.5),
            sin_emission=np.where(mean[:, 0] > 0, sine, 1.0),
        )
