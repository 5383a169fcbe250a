"""Clutter: clusters of glints that stand for furniture, plants and everything else.

All figures here are assumptions, kept together so that they can be varied.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes

FloatArray = npt.NDArray[np.float64]

EXPONENTS = (-0.5, 0.0, 0.5, 1.0)  # point-like, edge-like, curved, flat: spectrum f**g
GLINTS_PER_CLUSTER = (3, 12)
CLUSTER_RADIUS_M = 0.12
LEVEL_MEAN_DB, LEVEL_SPREAD_DB = -33.0, 5.0  # scattering length re 1 m, at 50 kHz
_REFERENCE_K = 2 * np.pi * 50e3 / 343.0


@dataclass(frozen=True, slots=True, eq=False)
class Clutter:
    """Glints in the world.

    positions_m : shape (n, 3)
    lengths_m : shape (n,)
        Scattering length at 50 kHz, signed.
    exponents : shape (n,)
    """

    positions_m: FloatArray
    lengths_m: FloatArray
    exponents: FloatArray

    @classmethod
    def none(cls) -> Clutter:
        """An empty room."""
        return cls(np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    @classmethod
    def scatter(
        cls,
        x_m: tuple[float, float],
        y_m: tuple[float, float],
        density_per_m2: float,
        rng: np.random.Generator,
        top_m: float = 1.6,
    ) -> Clutter:
        """Clusters strewn over a rectangle, up to ``top_m`` high; the density counts glints."""
        area = (x_m[1] - x_m[0]) * (y_m[1] - y_m[0])
        num_clusters = int(rng.poisson(density_per_m2 * area / np.mean(GLINTS_PER_CLUSTER)))
        if num_clusters == 0:
            return cls.none()
        sizes = rng.integers(*GLINTS_PER_CLUSTER, size=num_clusters)
        low, high = np.array([x_m[0], y_m[0], 0.0]), np.array([x_m[1], y_m[1], top_m])
        centres = np.repeat(rng.uniform(low, high, (num_clusters, 3)), sizes, axis=0)
        positions = centres + rng.normal(0, CLUSTER_RADIUS_M, centres.shape)
        level = np.repeat(rng.normal(LEVEL_MEAN_DB, LEVEL_SPREAD_DB, num_clusters), sizes)
        level = level + rng.normal(0, 4.0, level.shape)
        signs = rng.choice([-1.0, 1.0], level.shape)
        exponents = np.repeat(rng.choice(EXPONENTS, num_clusters), sizes)
        return cls(positions, signs * 10 ** (level / 20), exponents)

    def echoes(self, at_m: FloatArray, emitter: FloatArray, mics: FloatArray) -> Echoes:
        """Their echoes, the glints being at ``at_m`` (n, 3) in the sensor frame."""
        out = at_m - emitter
        there = np.linalg.norm(out, axis=1)
        back = np.linalg.norm(at_m[:, None, :] - mics[None], axis=2)
        near = np.maximum(there[:, None] * back, 0.04)
        sine = np.where(out[:, 0] > 0, np.hypot(out[:, 1], out[:, 2]) / there, 1.0)
        strength = self.lengths_m / _REFERENCE_K**self.exponents
        return Echoes.of(
            there[:, None] + back,
            strength[:, None] / near,
            exponent=self.exponents,
            sin_emission=sine,
        )
