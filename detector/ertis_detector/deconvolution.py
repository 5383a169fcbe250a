"""Impulse responses: what is heard, divided by what was emitted, where that can be done."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.imaging import AUDIO_RATE_HZ

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
Table = tuple[Float, Float]

# Against the strongest frequency's power: what chirp and sensor leave weaker than -20 dB is noise.
REGULARISATION = 0.01


class Deconvolution:
    """Regularised division (Wiener) by chirp, sensor and air, over a band.

    ``W = w conj(S) / (|S|^2 + e max |S|^2)``, with S the spectrum that a glint of strength 1
    returns and w a Hamming window over the band; scaled so that such a glint peaks at 1.

    Parameters
    ----------
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    num_samples : int
        Audio samples that are divided at once; leave ``chirp.size`` of them after the last echo.
    band_hz : (low, high)
        Used frequencies.
    sensor : (frequency_hz, level_db), optional
        Response of transducer and microphones, two arrays of shape (m,), frequencies rising; flat
        unless given.
    regularisation : float
        e above.
    air : Air
        Its absorption is divided out.

    Attributes
    ----------
    frequency_hz : float64, shape (num_bins,)
        Those inside the band.
    bandwidth_hz : float
        Of the whole division: as wide as a rectangle of the same sum and height.
    centre_hz : float
        Mean frequency of what comes out.
    """

    def __init__(
        self,
        chirp: Float,
        num_samples: int,
        band_hz: tuple[float, float],
        *,
        sensor: Table | None = None,
        regularisation: float = REGULARISATION,
        air: Air | None = None,
    ) -> None:
        low, high = band_hz
        if not 0 < low < high < AUDIO_RATE_HZ / 2:
            raise ValueError(
                f"band {band_hz} Hz, expected 0 < low < high < {AUDIO_RATE_HZ / 2:g}: give the "
                "frequencies that the chirp sweeps"
            )
        self.num_samples = num_samples
        self._size = int(scipy.fft.next_fast_len(num_samples, real=True))
        spacing = AUDIO_RATE_HZ / self._size
        self._first = int(np.ceil(low / spacing))
        bins = np.arange(self._first, int(high / spacing) + 1)
        self.frequency_hz: Float = np.asarray(bins * spacing, np.float64)
        self._air, self._regularisation = air or Air(), regularisation
        self._taper = _hamming(self.frequency_hz, band_hz)
        emitted = scipy.fft.rfft(chirp, self._size)[self._bins]
        if sensor is not None:
            emitted = emitted * 10 ** (np.interp(self.frequency_hz, *sensor) / 20)
        self._emitted: Complex = emitted
        shape = self._shape(np.abs(self._emitted) ** 2)
        self.bandwidth_hz = float(shape.sum() / shape.max() * spacing)
        self.centre_hz = float(shape @ self.frequency_hz / shape.sum())

    @property
    def _bins(self) -> slice:
        return slice(self._first, self._first + self.frequency_hz.size)

    def _shape(self, power: Float) -> Float:
        strongest = power.max(axis=-1, keepdims=True)
        return np.asarray(self._taper * power / (power + self._regularisation * strongest))

    def spectrum(self, audio: npt.NDArray[np.floating]) -> Complex:
        """Of audio, shape (..., num_samples), inside the band: (..., num_bins)."""
        if audio.shape[-1] != self.num_samples:
            raise ValueError(
                f"audio of {audio.shape[-1]} samples, expected {self.num_samples}: the fragment, "
                "and a chirp's length after it"
            )
        spectrum = scipy.fft.rfft(np.asarray(audio, np.float64), self._size, axis=-1)
        return np.asarray(spectrum[..., self._bins])

    def impulse_response(self, spectrum: Complex, range_m: Float | float) -> Complex:
        """Divide spectra, shape (n, num_bins), of sound from ``range_m``, shape (n,) or one.

        Returns
        -------
        complex128, shape (n, num_samples)
            At 450 kHz; the magnitude is the envelope. A glint peaks where its echo begins, at its
            amplitude (against 1 m, without absorption).
        """
        way_m = 2 * np.atleast_1d(np.asarray(range_m, float))[:, None]
        absorbed = 10 ** (-self._air.absorption_db_m(self.frequency_hz) * way_m / 20)
        glint = self._emitted * absorbed
        power = np.abs(glint) ** 2
        shape = self._shape(power)
        weight = shape * np.conj(glint) / np.maximum(power, 1e-30)
        full = np.zeros((len(spectrum), self._size), np.complex128)
        full[:, self._bins] = spectrum * weight * (self._size / shape.sum(axis=1, keepdims=True))
        return np.asarray(scipy.fft.ifft(full, axis=1)[:, : self.num_samples])

    def __call__(self, audio: npt.NDArray[np.floating], range_m: Float | float) -> Complex:
        """Impulse responses of audio, shape (n, num_samples); see ``impulse_response``."""
        return self.impulse_response(self.spectrum(audio), range_m)


def _hamming(frequency_hz: Float, band_hz: tuple[float, float]) -> Float:
    """Side lobes 43 dB down, for a width that is hardly more than without taper."""
    place = (frequency_hz - band_hz[0]) / (band_hz[1] - band_hz[0])
    return np.asarray(0.54 - 0.46 * np.cos(2 * np.pi * place))
