"""The dish's echo taken apart: when its glints arrive, and how strong they truly are.

The closed form has one unknown complex constant for each ring (``c_2``, ``c_3``, near 1) and
takes the part of a ring that still returns from geometry alone; both are measured here on
exact amplitudes. Lengths are in aperture radii, echo paths are from the sphere's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal.windows import hann, tukey

from ertis_simulator.reference.meridian import CapMeridian

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_CAP = CapMeridian.landmark()
VERTEX_PATH = 2 * _CAP.sphere_radius
RIM_PATH = 2 * _CAP.sphere_radius * float(np.cos(_CAP.half_opening_rad))
BOUNCES = (2, 3)


def incidence_rad(bounces: int) -> float:
    """Of the ring of rays that return after so many bounces."""
    return np.pi / 2 * (1 - 1 / bounces)


def ring_path(bounces: int) -> float:
    """Length of those rays, ``2 n R cos i``."""
    return 2 * bounces * _CAP.sphere_radius * float(np.cos(incidence_rad(bounces)))


def ring_strength(ka: npt.ArrayLike, bounces: int) -> FloatArray:
    """Amplitude of the whole ring in the closed form, ``b sqrt(2 pi k R cos i / (2 n))``."""
    incidence = incidence_rad(bounces)
    radius, chord = (_CAP.sphere_radius * part(incidence) for part in (np.sin, np.cos))
    wavenumber = np.asarray(ka, np.float64)
    return np.asarray(radius * np.sqrt(np.pi * wavenumber * chord / bounces))


def geometric_share(tilt_rad: npt.ArrayLike, bounces: int) -> FloatArray:
    """Geometry's share of a ring that returns from a tilted dish: 1 frontal, 0 past a limit."""
    tilt, incidence = np.asarray(tilt_rad, np.float64), incidence_rad(bounces)
    height = np.cos(tilt) * np.cos(incidence) - np.cos(_CAP.half_opening_rad)
    across = np.maximum(np.sin(tilt) * np.sin(incidence), 1e-9)
    return np.asarray(np.maximum(2 / np.pi * np.arcsin(np.clip(height / across, -1, 1)), 0))


def impulse_response(
    ka: FloatArray, amplitude: ComplexArray, path: FloatArray, *, narrow: bool = False
) -> ComplexArray:
    """Analytic band-limited echo against path length, shape (..., len(path)).

    ``ka`` is evenly spaced. A Hann window over the band gives the low sidelobes that weak
    glints need; ``narrow`` gives sharper peaks (a tenth of the band tapered).
    """
    window = tukey(len(ka), 0.2) if narrow else hann(len(ka))
    waves = np.exp(-1j * np.outer(ka, path))
    return np.asarray((amplitude * (window / window.sum())) @ waves)


@dataclass(frozen=True, slots=True)
class Arrival:
    """A glint found in an echo: its path, what the closed form says, and its peak."""

    name: str
    path: float
    expected_path: float
    peak: float


def arrivals(ka: FloatArray, amplitude: ComplexArray) -> list[Arrival]:
    """Strongest point of the echo near each glint's closed-form path, shape (num_ka,) in."""
    reach = np.linspace(-0.08, 0.08, 1601)
    expected = {"vertex": VERTEX_PATH, "two bounces": ring_path(2), "three bounces": ring_path(3)}
    found = []
    for name, path in expected.items():
        envelope = np.abs(impulse_response(ka, amplitude, path + reach))
        best = int(np.argmax(envelope))
        found.append(Arrival(name, float(path + reach[best]), path, float(envelope[best])))
    return found


def fit_glints(ka: FloatArray, amplitude: ComplexArray) -> dict[str, complex]:
    """Complex strength of vertex, rings and rim, relative to the closed form; rim in radii.

    Least squares over the band ``ka``; ``amplitude`` is that of one view, shape (num_ka,).
    """
    rings = [ring_strength(ka, n) * np.exp(1j * ka * ring_path(n)) for n in BOUNCES]
    vertex = -_CAP.sphere_radius / 2 * np.exp(1j * ka * VERTEX_PATH)
    columns = np.stack([vertex, *rings, np.exp(1j * ka * RIM_PATH)], axis=1)
    fitted, *_ = np.linalg.lstsq(columns, amplitude, rcond=None)
    return dict(zip(("vertex", "c_2", "c_3", "rim"), map(complex, fitted), strict=True))
