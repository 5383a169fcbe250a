"""How far another method's echoes are from the exact ones, in dB, correlation and microseconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.signal.windows import tukey

from ertis_simulator.reference.table import ReferenceTable, Views

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

CALL_BAND_HZ = (20e3, 80e3)  # the landmark chirp's
_SEARCH_PATH = 1.0  # aperture radii: the echo's glints are that far apart


class Method(Protocol):
    """Another way to the landmark's echo."""

    def __call__(self, ka: FloatArray, views: Views) -> npt.ArrayLike:
        """``f`` as :class:`ReferenceTable` defines it, shape (num_views, num_ka)."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """One radius and band, each array of shape (num_views,).

    views : Views
    level_db : float64
        Energy in the band, over the exact one.
    spectrum_db : float64
        RMS error of the amplitude spectrum, weighted by the exact energy: nulls count little.
    correlation : float64
        Of the band-limited impulse responses at the best delay.
    delay_s : float64
        That delay: positive is late; NaN where the method hears nothing.
    """

    views: Views
    level_db: FloatArray
    spectrum_db: FloatArray
    correlation: FloatArray
    delay_s: FloatArray

    def rows(self) -> list[str]:
        """A table for people: header, then a line for each view."""
        lines = ["tilt deg  apart deg  range a  level dB  spectrum dB  correlation  delay us"]
        view = self.views
        tilt, apart = np.rad2deg(view.bisector_tilt_rad), np.rad2deg(view.apart_rad)
        columns = (self.level_db, self.spectrum_db, self.correlation, self.delay_s * 1e6)
        for row in zip(tilt, apart, view.range_r, *columns, strict=True):
            lines.append("{:8.1f} {:10.1f} {:8.1f} {:9.2f} {:12.2f} {:12.3f} {:9.2f}".format(*row))
        return lines


def compare(
    method: Method,
    radius_m: float,
    *,
    table: ReferenceTable | None = None,
    band_hz: tuple[float, float] = CALL_BAND_HZ,
    speed_of_sound_m_s: float = 343.0,
) -> Agreement:
    """Hold a method against the stored exact echoes.

    Parameters
    ----------
    method : Method
        Called once, with the table's wavenumbers inside the band and all its views.
    radius_m : float
        Of the dish's aperture: decides which ``ka`` the band is.
    table : ReferenceTable, optional
        Instead of the one that ships.
    band_hz, speed_of_sound_m_s : (float, float), float

    Raises
    ------
    ValueError
        If the band leaves the table.
    """
    table = table or ReferenceTable.load()
    inside = _in_band(table.ka, radius_m, band_hz, speed_of_sound_m_s)
    ka, exact = table.ka[inside], table.amplitude[:, inside].astype(np.complex128)
    other = np.asarray(method(ka, table.views), np.complex128)
    if other.shape != exact.shape:
        raise ValueError(
            f"the method returned shape {other.shape}, expected {exact.shape}: "
            "return one row per view, one column per ka"
        )
    window = tukey(len(ka), 0.2)
    power = window * np.abs(exact) ** 2
    gain = np.abs(other) / np.maximum(np.abs(exact), 1e-12)
    gain_db = 20 * np.log10(np.maximum(gain, 1e-6))
    energy, exact_energy = (window * np.abs(other) ** 2).sum(axis=1), power.sum(axis=1)
    correlation, path = best_match(ka, window * other * exact.conj())
    return Agreement(
        table.views,
        10 * np.log10(np.maximum(energy / exact_energy, 1e-12)),
        np.sqrt((power * gain_db**2).sum(axis=1) / exact_energy),
        correlation / np.sqrt(np.maximum(energy * exact_energy, 1e-30)),
        np.where(energy > 0, path * radius_m / speed_of_sound_m_s, np.nan),
    )


def _in_band(
    ka: FloatArray, radius_m: float, band_hz: tuple[float, float], speed_of_sound_m_s: float
) -> npt.NDArray[np.bool_]:
    low, high = (2 * np.pi * f / speed_of_sound_m_s * radius_m for f in band_hz)
    if low < ka[0] or high > ka[-1]:
        raise ValueError(
            f"{radius_m * 1e3:.0f} mm at {band_hz[0] / 1e3:.0f}-{band_hz[1] / 1e3:.0f} kHz is "
            f"ka {low:.1f}-{high:.1f}, the table has {ka[0]:.1f}-{ka[-1]:.1f}: "
            "choose another band or make a wider table"
        )
    return np.asarray((ka >= low) & (ka <= high))


def best_match(ka: FloatArray, cross: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Find how well echoes match at their best delay.

    Parameters
    ----------
    ka : shape (num_ka,)
        Evenly spaced.
    cross : shape (num_views, num_ka)
        One echo's amplitudes times the conjugate of the other's.

    Returns
    -------
    float64, float64, shape (num_views,) each
        Largest cross-correlation, and the extra path (aperture radii) that it is at.
    """
    step = 2 * np.pi / ka[-1] / 64
    reach = int(np.ceil(_SEARCH_PATH / step))
    path = step * np.arange(-reach, reach + 1)
    matched = (cross @ np.exp(-1j * np.outer(ka, path))).real
    best = matched.argmax(axis=1)
    return matched[np.arange(len(matched)), best], path[best]
