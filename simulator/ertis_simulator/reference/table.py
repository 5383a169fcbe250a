"""Stored exact echoes of the landmark's dish, to compare other methods with."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_simulator.reference.meridian import CapMeridian
from ertis_simulator.reference.screen import Screen

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

log = logging.getLogger(__name__)

# 15-110 kHz for all radii is 9.6-142; steps of 0.5 leave 12 aperture radii of path unambiguous.
TABLE_KA = np.arange(8.0, 150.01, 0.5)
_TILTS_DEG = (*np.arange(0, 30, 2.5), *np.arange(30, 91, 5.0))
_APART_DEG, _APART_TILTS_DEG = (2.0, 4.0, 6.0), (0.0, 10.0, 20.0, 30.0, 45.0)
_NEAR_R = (0.6 / 0.070, 0.6 / 0.035)  # 0.6 m for the largest and the smallest landmark
_NEAR_TILTS_DEG = (0.0, 10.0, 20.0, 30.0, 45.0)


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Where sources and microphones stand, seen from the sphere's centre.

    source_tilt_rad, mic_tilt_rad : float64, shape (num_views,)
        From the dish's axis.
    azimuth_rad : float64, shape (num_views,)
        Around the axis, from source to microphone.
    range_r : float64, shape (num_views,)
        Distance of both, in aperture radii; infinite is the far field.
    """

    source_tilt_rad: FloatArray
    mic_tilt_rad: FloatArray
    azimuth_rad: FloatArray
    range_r: FloatArray

    @classmethod
    def of(
        cls,
        tilt_rad: npt.ArrayLike,
        apart_rad: float = 0.0,
        across: bool = False,
        range_r: float = np.inf,
    ) -> Views:
        """Views with the bisector of source and microphone at ``tilt_rad``.

        The two stand ``apart_rad`` apart, in the plane of the tilt or across it.
        """
        tilt = np.atleast_1d(np.asarray(tilt_rad, np.float64))
        if across:
            source = mic = np.arccos(np.cos(apart_rad / 2) * np.cos(tilt))
            azimuth = 2 * np.arctan2(np.sin(apart_rad / 2), np.cos(apart_rad / 2) * np.sin(tilt))
        else:
            source, mic = tilt - apart_rad / 2, tilt + apart_rad / 2
            azimuth = np.zeros_like(tilt)
        return cls(source, mic, azimuth, np.full_like(tilt, range_r))

    @classmethod
    def join(cls, parts: Sequence[Views]) -> Views:
        """All views of several sets, in order."""
        return cls(
            np.concatenate([part.source_tilt_rad for part in parts]),
            np.concatenate([part.mic_tilt_rad for part in parts]),
            np.concatenate([part.azimuth_rad for part in parts]),
            np.concatenate([part.range_r for part in parts]),
        )

    @property
    def apart_rad(self) -> FloatArray:
        """Angle between source and microphone, shape (num_views,)."""
        half = np.sin((self.source_tilt_rad - self.mic_tilt_rad) / 2) ** 2
        sines = np.sin(self.source_tilt_rad) * np.sin(self.mic_tilt_rad)
        return np.asarray(2 * np.arcsin(np.sqrt(half + sines * np.sin(self.azimuth_rad / 2) ** 2)))

    @property
    def bisector_tilt_rad(self) -> FloatArray:
        """Angle from the axis to the direction midway between the two, shape (num_views,)."""
        source, mic = self.source_tilt_rad, self.mic_tilt_rad
        along = (np.cos(source) + np.cos(mic)) / 2
        square = np.sin(source) ** 2 + np.sin(mic) ** 2
        across = square + 2 * np.sin(source) * np.sin(mic) * np.cos(self.azimuth_rad)
        return np.asarray(np.arctan2(np.sqrt(np.maximum(across, 0)) / 2, along))

    def amplitude(self, ka: float) -> ComplexArray:
        """Exact ``f`` of the landmark's dish in aperture radii, shape (num_views,)."""
        screen = Screen.build(CapMeridian.landmark(), ka)
        return screen.amplitude(
            self.source_tilt_rad, self.mic_tilt_rad, self.azimuth_rad, self.range_r, self.range_r
        )


def table_views() -> Views:
    """The stored table's views: monostatic, bistatic in and across the tilt's plane, and near."""
    apart_tilts, near_tilts = np.deg2rad(_APART_TILTS_DEG), np.deg2rad(_NEAR_TILTS_DEG)
    parts = [Views.of(np.deg2rad(_TILTS_DEG))]
    for apart in np.deg2rad(_APART_DEG):
        parts += [Views.of(apart_tilts, float(apart), across) for across in (False, True)]
    parts += [Views.of(near_tilts, range_r=range_r) for range_r in _NEAR_R]
    return Views.join(parts)


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceTable:
    """Exact scattering amplitudes of the landmark's dish.

    ka : float64, shape (num_ka,)
        Wavenumber times aperture radius, evenly spaced.
    views : Views
    amplitude : complex64, shape (num_views, num_ka)
        In aperture radii, phase from the sphere's centre, ``exp(-i w t)``.
    """

    ka: FloatArray
    views: Views
    amplitude: npt.NDArray[np.complex64]

    @classmethod
    def compute(cls, ka: FloatArray, views: Views) -> ReferenceTable:
        """Solve at every ``ka``: some 12 minutes of one core for the stored table."""
        columns, begun = [], time.monotonic()
        for index, value in enumerate(ka):
            columns.append(views.amplitude(float(value)))
            if index % 20 == 0:
                spent = time.monotonic() - begun
                log.info("ka %.2f, %d of %d, %.0f s", value, index + 1, len(ka), spent)
        return cls(ka, views, np.stack(columns, axis=1).astype(np.complex64))

    def save(self, path: Path) -> None:
        """Write an npz file."""
        view = self.views
        angles = view.source_tilt_rad, view.mic_tilt_rad, view.azimuth_rad
        geometry = np.stack([*angles, view.range_r])
        np.savez(path, ka=self.ka, geometry=geometry, amplitude=self.amplitude)

    @classmethod
    def load(cls, path: Path | None = None) -> ReferenceTable:
        """Read ``path``, or the table that ships with the simulator."""
        if path is None:
            with as_file(files("ertis_simulator") / "data" / "dish_reference.npz") as shipped:
                return cls.load(shipped)
        with np.load(path) as data:
            return cls(data["ka"], Views(*data["geometry"]), data["amplitude"])

    def monostatic(self, range_r: float = np.inf) -> tuple[FloatArray, npt.NDArray[np.complex64]]:
        """Tilts in rad, and the amplitudes there, of source and microphone in one place."""
        view = self.views
        together = (view.source_tilt_rad == view.mic_tilt_rad) & (view.azimuth_rad == 0)
        chosen = together & np.isclose(view.range_r, range_r)
        return view.source_tilt_rad[chosen], self.amplitude[chosen]
