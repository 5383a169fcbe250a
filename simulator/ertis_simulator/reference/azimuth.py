"""Azimuthal Fourier modes of Green's function between two rings."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.fft import dct, next_fast_len

from ertis_simulator.reference.meridian import Curve
from ertis_simulator.reference.rules import gauss

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Values = TypeVar("Values", FloatArray, ComplexArray)

_DYADIC_LEVELS = 20  # to some 1e-7: nearer pairs of points have no weight
_DYADIC_POINTS = 10
_CYCLES, _CYCLE_POINTS = 4, 24
_CHUNK = 512


class AzimuthRule:
    """Angles in [0, pi], and how an even function there becomes its Fourier modes.

    cosines : float64, shape (num_angles,)
        Of the angles.
    """

    def __init__(self, angles: FloatArray, num_modes: int, weights: FloatArray | None) -> None:
        """With no ``weights`` the angles are even, and a cosine transform is quicker."""
        self.cosines = np.cos(angles)
        self._sin2_half = np.sin(angles / 2) ** 2
        self._num_modes = num_modes
        self._matrix: FloatArray | None = None
        if weights is not None:
            self._matrix = np.cos(np.outer(angles, np.arange(num_modes))) * weights[:, None] / np.pi

    @classmethod
    def smooth(cls, num_modes: int, bandwidth: float, decay: float) -> AzimuthRule:
        """The trapezoidal rule, for rings at least ``decay`` of their radius apart.

        bandwidth : float
            k times the largest ring radius.
        """
        least = (num_modes + bandwidth + 22 / decay) / 2 + 8
        count = next_fast_len(int(np.ceil(max(least, num_modes))), real=True)
        return cls(np.pi * np.arange(count + 1) / count, num_modes, None)

    @classmethod
    def peaked(cls, num_modes: int, bandwidth: float) -> AzimuthRule:
        """Panels that halve towards 0, for rings however close."""
        count = int(np.ceil((num_modes + bandwidth) / 2 / _CYCLES)) + 2
        edges = np.pi * np.arange(1, count + 1) / count
        inner = edges[0] * 2.0 ** np.arange(-_DYADIC_LEVELS, 1)
        pieces = [
            _composite(np.append(0.0, inner), _DYADIC_POINTS),
            _composite(edges, _CYCLE_POINTS),
        ]
        angles, weights = (np.concatenate(part) for part in zip(*pieces, strict=True))
        return cls(angles, num_modes, weights)

    def modes(self, values: Values) -> Values:
        """Mean of ``values`` (last axis: angles) times ``cos(m angle)``; last axis: modes."""
        if self._matrix is not None:
            return values @ self._matrix
        transformed = dct(values, type=1, axis=-1)[..., : self._num_modes]
        return np.asarray(transformed / (2 * (values.shape[-1] - 1)), values.dtype)

    def green(self, near: Curve, far: Curve, wavenumber: float) -> ComplexArray:
        """Modes of ``exp(i k r) / (4 pi r)``, shape (num_modes, num_pairs)."""
        flat = (near.rho - far.rho) ** 2 + (near.z - far.z) ** 2
        across = 4 * near.rho * far.rho
        modes = np.empty((self._num_modes, len(flat)), np.complex128)
        for start in range(0, len(flat), _CHUNK):
            part = slice(start, start + _CHUNK)
            r = np.sqrt(flat[part, None] + across[part, None] * self._sin2_half)
            phase = wavenumber * r
            r *= 4 * np.pi
            modes.real[:, part] = self.modes(np.cos(phase) / r).T
            modes.imag[:, part] = self.modes(np.sin(phase) / r).T
        return modes


def _composite(edges: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = gauss(count)
    widths = np.diff(edges)
    angles = edges[:-1, None] + widths[:, None] * nodes
    return angles.ravel(), (widths[:, None] * weights).ravel()
