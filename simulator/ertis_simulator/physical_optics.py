"""Iterated physical optics: what a rigid spherical cap scatters from its concave face.

The pressure on the face is twice the incident wave where that reaches it, and then, bounce after
bounce, the surface integral of the last bounce's pressure. On a sphere the kernel of two points
depends only on the angle between them, and the cap is a body of revolution: in azimuthal modes
each bounce is one small matrix product. Lengths in aperture radii, e^{-iwt}, origin at the centre
of the sphere, z out of the opening. Only ``ka`` matters: all dishes of one depth are one shape.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.fft

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

BOUNCES = 6
POINTS_PER_WAVELENGTH = 8.0


class CapOptics:
    """One cap at one frequency.

    Parameters
    ----------
    depth_ratio : float
        Depth over aperture radius, in (0, 1].
    ka : float
        Wavenumber times aperture radius.
    bounces : int
        1 is the plain Kirchhoff approximation.
    points_per_wavelength : float
        Along the arc from vertex to rim.
    """

    def __init__(
        self,
        depth_ratio: float,
        ka: float,
        *,
        bounces: int = BOUNCES,
        points_per_wavelength: float = POINTS_PER_WAVELENGTH,
    ) -> None:
        self.ka = ka
        self.bounces = bounces
        self.radius = (1 + depth_ratio**2) / (2 * depth_ratio)
        self.half_opening = float(np.arccos(1 - depth_ratio / self.radius))
        arc = self.radius * self.half_opening
        num = int(np.ceil(points_per_wavelength * ka * arc / (2 * np.pi))) + 10
        nodes, weights = np.polynomial.legendre.leggauss(num)
        self.polar = (nodes + 1) / 2 * self.half_opening
        self._step = weights / 2 * self.half_opening
        self.area = self._step * self.radius**2 * np.sin(self.polar) * 2 * np.pi
        self.num_modes = int(np.ceil(ka)) + 12
        wanted = max(points_per_wavelength * ka / np.pi + 64, 2 * self.num_modes)
        self.num_azimuths = 2 * scipy.fft.next_fast_len(int(wanted) // 2 + 1, real=True)
        self.azimuth = 2 * np.pi * np.arange(self.num_azimuths) / self.num_azimuths

    @cached_property
    def points(self) -> FloatArray:
        """Of the face, shape (num_polar, num_azimuths, 3)."""
        ring, around = np.sin(self.polar)[:, None], self.azimuth[None, :]
        down = np.broadcast_to(-np.cos(self.polar)[:, None], (self.polar.size, self.azimuth.size))
        return self.radius * np.stack([ring * np.cos(around), ring * np.sin(around), down], axis=2)

    @cached_property
    def bounce(self) -> npt.NDArray[np.complex64]:
        """One bounce: pressure to pressure, shape (num_modes, num_polar, num_polar)."""
        num, half = self.polar.size, self.num_azimuths // 2 + 1
        matrix = np.empty((self.num_modes, num, num), np.complex64)
        cos_around = np.cos(self.azimuth[:half])
        side = 2 * np.pi / self.num_azimuths * self.radius * np.sin(self.polar)
        tall = self._step * self.radius
        for row, polar in enumerate(self.polar):
            cos_apart = (
                np.cos(polar) * np.cos(self.polar[row:, None])
                + np.sin(polar) * np.sin(self.polar[row:, None]) * cos_around
            )
            apart = self.radius * np.sqrt(np.maximum(2 - 2 * cos_apart, 1e-30))
            inverse = 1 / apart
            # The mean of 1/r over the point's own cell: the kernel is weakly singular there.
            u, v = side[row], tall[row]
            inverse[0, 0] = 2 / v * np.arcsinh(v / u) + 2 / u * np.arcsinh(u / v)
            kernel = (inverse - 1j * self.ka) * np.exp(1j * self.ka * apart)
            kernel[0, 0] = inverse[0, 0]
            modes = self._even_modes(kernel)
            modes /= 4 * np.pi * self.radius
            matrix[:, row, row:] = modes.T
            matrix[:, row:, row] = modes.T
        return matrix * self.area.astype(np.float32)

    def reached(self, toward: FloatArray) -> npt.NDArray[np.bool_]:
        """Where a ray toward ``toward`` leaves the face and misses the rest of the cap.

        toward : unit vectors, shape (..., 3), one for all points or one each
        """
        points = self.points
        rise = -np.sum(points * toward, axis=-1) / self.radius
        leaves_at = points[..., 2] + 2 * self.radius * rise * toward[..., 2]
        return np.asarray((rise > 0) & (leaves_at > -self.radius * np.cos(self.half_opening)))

    @cached_property
    def all_bounces(self) -> npt.NDArray[np.complex64]:
        """First pressure to the sum over all bounces, shaped as ``bounce``."""
        one = np.eye(self.polar.size, dtype=np.complex64)
        if self.bounces == 1:
            return np.broadcast_to(one, (self.num_modes, *one.shape))
        total = self.bounce + one
        for _ in range(self.bounces - 2):
            total = self.bounce @ total + one
        return np.asarray(total)

    def far_field(
        self, tilt_in: FloatArray, tilt_out: FloatArray, azimuth_apart: FloatArray
    ) -> ComplexArray:
        """Scattering length over aperture radius, for directions there and back.

        Parameters
        ----------
        tilt_in, tilt_out, azimuth_apart : shape (num_pairs,), rad
            Tilts off the axis toward source and observer, and the azimuth between them.

        Returns
        -------
        complex128, shape (num_pairs,)
            Mean of the two ways round, which differ as far as physical optics is not reciprocal.
        """
        there, back = self._both_ways(tilt_in, tilt_out, azimuth_apart)
        return (there + back) / 2

    def asymmetry(
        self, tilt_in: FloatArray, tilt_out: FloatArray, azimuth_apart: FloatArray
    ) -> FloatArray:
        """By how much the two ways round differ from each other, against their mean."""
        there, back = self._both_ways(tilt_in, tilt_out, azimuth_apart)
        return np.asarray(np.abs(there - back) / np.abs((there + back) / 2))

    def _both_ways(
        self, tilt_in: FloatArray, tilt_out: FloatArray, azimuth_apart: FloatArray
    ) -> tuple[ComplexArray, ComplexArray]:
        order = np.arange(self.num_modes)[:, None]
        turns = np.where(order == 0, 1, 2) * np.cos(order * azimuth_apart)
        turns = turns * (-1j * self.ka / (2 * np.pi))
        (wave_in, weighed_in), (wave_out, weighed_out) = (
            self._plane_modes(tilt) for tilt in (tilt_in, tilt_out)
        )
        there = np.sum((self.all_bounces @ wave_in) * weighed_out, axis=1)
        back = np.sum((self.all_bounces @ wave_out) * weighed_in, axis=1)
        return np.sum(there * turns, axis=0), np.sum(back * turns, axis=0)

    def _plane_modes(
        self, tilts: FloatArray
    ) -> tuple[npt.NDArray[np.complex64], npt.NDArray[np.complex64]]:
        """Of plane waves from many tilts, each of shape (num_modes, num_polar, num_tilts).

        The wave where it reaches the face, and the same weighed by area and cosine of incidence.
        """
        half = np.cos(self.azimuth[: self.num_azimuths // 2 + 1])
        bare, weighed = [], []
        for tilt in tilts:
            rise = np.cos(tilt) * np.cos(self.polar)[:, None]
            rise = rise - np.sin(tilt) * np.sin(self.polar)[:, None] * half
            height = 2 * rise * np.cos(tilt) - np.cos(self.polar)[:, None]
            reached = (rise > 0) & (height > -np.cos(self.half_opening))
            wave = np.exp(1j * self.ka * self.radius * rise) * reached
            bare.append(self._even_modes(wave))
            weighed.append(self._even_modes(wave * rise) * self.area[:, None])
        return tuple(np.array(x, np.complex64).transpose(2, 1, 0) for x in (bare, weighed))

    def _even_modes(self, field: ComplexArray) -> ComplexArray:
        """Azimuthal modes of an even field given over half a turn, shape (num_polar, num_modes)."""
        return np.asarray(
            scipy.fft.dct(field, type=1, axis=1)[:, : self.num_modes] / self.num_azimuths
        )

    def near_field(self, source: FloatArray, receivers: FloatArray) -> ComplexArray:
        """Scattered pressure of a point source e^{ikr}/r.

        Parameters
        ----------
        source, receivers : shape (3,) and (num_receivers, 3)
            In aperture radii, from the centre of the sphere.

        Returns
        -------
        complex128, shape (num_receivers,)
        """
        away = source - self.points
        distance = np.linalg.norm(away, axis=2)
        first = np.exp(1j * self.ka * distance) / distance * 2
        first = first * self.reached(away / distance[..., None])
        # A general source is not even in azimuth: all modes, negative ones too.
        spread = scipy.fft.fft(first, axis=1) / self.num_azimuths
        kept = np.concatenate([spread[:, : self.num_modes], spread[:, : -self.num_modes : -1]], 1)
        order = np.concatenate([np.arange(self.num_modes), np.arange(1, self.num_modes)])
        split = self.num_modes
        both = np.zeros((split, self.polar.size, 2), np.complex64)
        both[:, :, 0] = kept[:, :split].T
        both[1:, :, 1] = kept[:, split:].T
        total = self.all_bounces @ both
        full = np.zeros_like(spread)
        full[:, order[:split]] = total[:, :, 0].T
        full[:, -order[split:]] = total[1:, :, 1].T
        on_face = scipy.fft.ifft(full, axis=1) * self.num_azimuths
        on_face *= self.area[:, None] / self.num_azimuths
        return np.array([self._radiated(on_face, at) for at in receivers])

    def _radiated(self, on_face: ComplexArray, at: FloatArray) -> complex:
        """Pressure at one point of the surface integral."""
        away = at - self.points
        distance = np.linalg.norm(away, axis=2)
        toward = away / distance[..., None]
        rise = -np.sum(self.points * toward, axis=2) / self.radius
        # d/dn of the Green function at the face, normal into the air: -(ik - 1/r) G cos.
        slope = (1 / distance - 1j * self.ka) * np.exp(1j * self.ka * distance) * rise
        slope = slope / (4 * np.pi * distance) * self.reached(toward)
        return complex(np.sum(on_face * slope))
