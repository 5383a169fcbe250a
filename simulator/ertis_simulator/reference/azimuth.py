"""Azimuthal Fourier modes of Green's function between two rings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.reference.meridian import Curve
from ertis_simulator.reference.rules import gauss

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_DYADIC_LEVELS = 26  # the nearest pairs of points are some 1e-7 apart
_DYADIC_POINTS = 10
_CYCLES, _CYCLE_POINTS = 4, 24
_CHUNK = 1024


@dataclass(frozen=True, slots=True)
class AzimuthRule:
    """Angles in [0, pi] and the matrix that takes an even function there to its modes.

    to_modes : float64, shape (num_angles, num_modes)
        Column m integrates ``cos(m angle) / pi`` over [0, pi].
    """

    sin2_half: FloatArray
    cosines: FloatArray
    to_modes: FloatArray

    @classmethod
    def smooth(cls, num_modes: int, bandwidth: float, decay: float) -> AzimuthRule:
        """The trapezoidal rule, for rings at least ``decay`` of their radius apart.

        bandwidth : float
            k times the largest ring radius.
        """
        count = int(np.ceil((num_modes + bandwidth + 22 / decay) / 2)) + 8
        angles = np.pi * np.arange(count + 1) / count
        weights = np.full(count + 1, np.pi / count)
        weights[[0, -1]] /= 2
        return cls._of(angles, weights, num_modes)

    @classmethod
    def peaked(cls, num_modes: int, bandwidth: float) -> AzimuthRule:
        """Panels that halve towards 0, for rings however close."""
        count = int(np.ceil((num_modes + bandwidth) / 2 / _CYCLES)) + 2
        edges = np.pi * np.arange(1, count + 1) / count
        inner = edges[0] * 2.0 ** np.arange(-_DYADIC_LEVELS, 1)
        pieces = [
            _composite(np.append(0.0, inner), _DYADIC_POINTS + 4),
            _composite(edges, _CYCLE_POINTS),
        ]
        angles, weights = (np.concatenate(part) for part in zip(*pieces, strict=True))
        return cls._of(angles, weights, num_modes)

    @classmethod
    def _of(cls, angles: FloatArray, weights: FloatArray, num_modes: int) -> AzimuthRule:
        modes = np.cos(np.outer(angles, np.arange(num_modes)))
        to_modes = modes * weights[:, None] / np.pi
        return cls(np.sin(angles / 2) ** 2, np.cos(angles), to_modes)

    def green(self, near: Curve, far: Curve, wavenumber: float) -> ComplexArray:
        """Modes of ``exp(i k r) / (4 pi r)``, shape (num_modes, num_pairs)."""
        flat = (near.rho - far.rho) ** 2 + (near.z - far.z) ** 2
        across = 4 * near.rho * far.rho
        modes = np.empty((self.to_modes.shape[1], len(flat)), np.complex128)
        for start in range(0, len(flat), _CHUNK):
            part = slice(start, start + _CHUNK)
            r = np.sqrt(flat[part, None] + across[part, None] * self.sin2_half)
            phase = wavenumber * r
            r *= 4 * np.pi
            modes.real[:, part] = ((np.cos(phase) / r) @ self.to_modes).T
            modes.imag[:, part] = ((np.sin(phase) / r) @ self.to_modes).T
        return modes


def _composite(edges: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = gauss(count)
    widths = np.diff(edges)
    angles = edges[:-1, None] + widths[:, None] * nodes
    return angles.ravel(), (widths[:, None] * weights).ravel()
