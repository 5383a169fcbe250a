"""Exact scattering by a rigid, thin screen of revolution, by boundary elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.reference.azimuth import AzimuthRule
from ertis_simulator.reference.galerkin import galerkin_matrices
from ertis_simulator.reference.meridian import Meridian, Panels
from ertis_simulator.reference.rules import gauss, lagrange

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

DEGREE = 8
PANELS_PER_WAVELENGTH = 1.0  # of 8 unknowns each
MODE_MARGIN = 10


@dataclass(frozen=True, slots=True)
class Screen:
    """A screen at one wavenumber, ready for any number of sources and microphones.

    matrix : complex128, shape (num_modes, num_nodes, num_nodes)
        Of the Galerkin equations.
    """

    panels: Panels
    degree: int
    wavenumber: float
    matrix: ComplexArray

    @classmethod
    def build(
        cls,
        meridian: Meridian,
        wavenumber: float,
        degree: int = DEGREE,
        panels_per_wavelength: float = PANELS_PER_WAVELENGTH,
        max_tilt_rad: float = np.pi / 2,
        mode_margin: int = MODE_MARGIN,
    ) -> Screen:
        """Set up the equations.

        Parameters
        ----------
        meridian : Meridian
            The screen; its unit of length is that of all results.
        wavenumber : float
            In radians per unit of length.
        degree, panels_per_wavelength : int, float
            Resolution: polynomials on each panel, and how many panels.
        max_tilt_rad : float
            Of any source or microphone: decides how many azimuthal modes there are.
        mode_margin : int
            Modes beyond k times the radius times the sine of that tilt.
        """
        panels = Panels.cut(meridian, wavenumber, panels_per_wavelength)
        sine = np.sin(min(max_tilt_rad, np.pi / 2))
        num_modes = int(np.ceil(wavenumber * meridian.max_rho * sine)) + mode_margin + 1
        matrix = galerkin_matrices(panels, degree, wavenumber, num_modes)[:, :-1, :-1]
        matrix[1:, 0, :] = matrix[1:, :, 0] = 0  # only mode 0 has pressure on the axis
        matrix[1:, 0, 0] = 1
        return cls(panels, degree, wavenumber, matrix)

    def amplitude(
        self,
        source_tilt_rad: npt.ArrayLike,
        mic_tilt_rad: npt.ArrayLike,
        azimuth_rad: npt.ArrayLike = 0.0,
        source_r: npt.ArrayLike = np.inf,
        mic_r: npt.ArrayLike = np.inf,
    ) -> ComplexArray:
        """What returns from the direction of a source to that of a microphone.

        Parameters
        ----------
        source_tilt_rad, mic_tilt_rad : array_like
            Angles from the axis to the source and to the microphone, seen from the origin.
        azimuth_rad : array_like
            From the source's half-plane around the axis to the microphone's.
        source_r, mic_r : array_like
            Their distances from the origin; infinite is a plane wave, or the far field.

        Returns
        -------
        complex128, shape of the arguments broadcast
            ``f`` of ``p = f exp(i k (r_s + r_m)) / (r_s r_m)`` for a source ``exp(i k r) / r``.
        """
        wanted = np.broadcast_arrays(source_tilt_rad, source_r, mic_tilt_rad, mic_r, azimuth_rad)
        tilt_s, r_s, tilt_m, r_m, azimuth = (np.ravel(part).astype(float) for part in wanted)
        points = np.concatenate([np.stack([tilt_s, r_s], 1), np.stack([tilt_m, r_m], 1)])
        points, which = np.unique(points, axis=0, return_inverse=True)
        source, mic = np.split(which.ravel(), 2)
        loads = self._loads(points[:, 0], points[:, 1])
        used, source = np.unique(source, return_inverse=True)
        jumps = np.linalg.solve(self.matrix, loads[:, :, used])
        modes = np.arange(len(self.matrix))
        around = np.cos(np.outer(modes, azimuth)) * np.where(modes == 0, 1, 2)[:, None]
        total = np.einsum("mnp,mnp,mp->p", loads[:, :, mic], jumps[:, :, source], around)
        return np.asarray(-total / (4 * np.pi)).reshape(wanted[0].shape)

    def _loads(self, tilt_rad: FloatArray, r: FloatArray) -> ComplexArray:
        """Normal velocity of the incident fields against each node's polynomial."""
        u, weights = gauss(self.degree + 5)
        count, num_modes = len(self.panels), len(self.matrix)
        curve, slope = self.panels.at(np.arange(count)[:, None], u)
        reach = self.wavenumber * self.panels.meridian.max_rho
        azimuth = AzimuthRule.smooth(num_modes, reach, decay=0.5)
        basis = lagrange(self.degree, u)[0] * weights[:, None]
        loads = np.zeros((num_modes, count * self.degree + 1, len(tilt_rad)), np.complex128)
        for column, (tilt, distance) in enumerate(zip(tilt_rad, r, strict=True)):
            rho, z = curve.rho[..., None], curve.z[..., None]
            normal = -curve.z_s[..., None], curve.rho_s[..., None]
            field = _normal_slope(
                rho, z, normal, azimuth.cosines, float(tilt), float(distance), self.wavenumber
            )
            modes = azimuth.modes(field) * (2 * np.pi * curve.rho * slope)[..., None]
            local = np.einsum("pqm,qa->mpa", modes, basis)
            for panel in range(count):
                start = panel * self.degree
                loads[:, start : start + self.degree + 1, column] += local[:, panel]
        loads[1:, 0] = 0
        return loads[:, :-1]


def _normal_slope(
    rho: FloatArray,
    z: FloatArray,
    normal: tuple[FloatArray, FloatArray],
    cosine: FloatArray,
    tilt_rad: float,
    r: float,
    wavenumber: float,
) -> ComplexArray:
    """Slope along the normal of ``r exp(-i k r) exp(i k R) / R``, or of its plane wave."""
    across, along = np.sin(tilt_rad), np.cos(tilt_rad)
    towards = rho * across * cosine + z * along
    facing = normal[0] * across * cosine + normal[1] * along
    if np.isinf(r):
        return np.asarray(-1j * wavenumber * facing * np.exp(-1j * wavenumber * towards))
    square = rho**2 + z**2
    distance = np.sqrt(r**2 - 2 * r * towards + square)
    # Written so that the difference keeps its digits at large r.
    extra = (square - 2 * r * towards) / (distance + r)
    outward = (normal[0] * rho + normal[1] * z - r * facing) / distance
    slope = (1j * wavenumber - 1 / distance) * outward
    return np.asarray(r / distance * slope * np.exp(1j * wavenumber * extra))
