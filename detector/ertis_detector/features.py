"""What the classifier sees of an echo: its spectrum, its envelope, and how it adds up.

The compressed fragment is divided by what any reflector would return (chirp, transducer,
spreading, absorption at that range, the emitter's beam), so that what is left is the reflector's
own. A dish shows in it as a weak vertex echo and strong rings a fixed time after (docs/dish.md):
in the envelope, in the spectrum's ripple, and in the spectrum's transform, the autocorrelation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.fragment import FRAGMENT_SAMPLES, gate, hann
from ertis_detector.imaging import RATE_HZ, Complex, Float, Focus, MatchedFilter, phasor
from ertis_detector.piston import piston_pattern

FEATURE_VERSION = "echo-1"  # stored in models: other versions do not fit
NUM_BINS = 32
_BAND_HZ = (24e3, 80e3)  # beyond it the sensor leaves too little of any chirp to be divided by
_EDGE_HZ = 2e3  # at both ends of the chirp's band the matched filter fades out
_STEP_S = 8e-6  # a seventh of the band's period
_LAGS_S = _STEP_S * np.arange(-32, 27)  # of the envelope, around its peak
_SEARCH_S = _STEP_S * np.arange(-7, 8)  # the peak itself, around the located one
_DELAYS_S = _STEP_S * np.arange(1, 34)  # of the autocorrelation
_SUBBANDS = np.linspace(-0.75, 0.75, 7)  # of the array's coherence, in halves of the chirp's band
_COHERENCE_SAMPLES = 32  # of the baseband: 190 us, the rings
NUM_SCALARS = 7
NUM_FEATURES = NUM_SCALARS + NUM_BINS + _LAGS_S.size + _DELAYS_S.size + _SUBBANDS.size
COHERENCE = slice(NUM_FEATURES - _SUBBANDS.size, NUM_FEATURES)  # the columns that tell it

# Response of transducer and microphones together, dB, as published for the SensComp 7000 and
# heard in a real ping; only its shape matters, and what is left of it every model learns.
_SENSOR_HZ = np.array([15e3, 20e3, 30e3, 40e3, 50e3, 60e3, 80e3, 100e3])
_SENSOR_DB = np.array([-34.0, -30.0, -20.0, -8.0, 0.0, -3.0, -12.0, -24.0])
_LEAST_GAIN_DB = -45.0  # under it there is only noise to be lifted
_LEAST_PATTERN = 0.15  # near the emitter's nulls nothing can be made good
_REGULARISER = 0.03  # of the chirp's strongest frequency
_HUMIDITY_PERCENT = 50.0  # few robots measure it: learnt from echoes of any


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where fragments were heard; all of shape (n,).

    range_m, azimuth_rad, elevation_rad : float64
        Of the echo's peak.
    snr_db : float64
        Of the beam over the image's noise floor.
    """

    range_m: Float
    azimuth_rad: Float
    elevation_rad: Float
    snr_db: Float


class EchoFeatures:
    """Features of the fragments of one sonar's pings.

    Parameters
    ----------
    matched_filter : MatchedFilter
        That compressed them.
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    air : Air
        For absorption, which takes it for half moist.

    Attributes
    ----------
    frequency_hz : shape (num_frequencies,)
        Where reflectivity is told, low to high.
    """

    def __init__(self, matched_filter: MatchedFilter, chirp: Float, air: Air) -> None:
        info = matched_filter.baseband
        half_band_hz = info.half_band_hz - _EDGE_HZ
        low = max(_BAND_HZ[0], info.carrier_hz - half_band_hz)
        high = min(_BAND_HZ[1], info.carrier_hz + half_band_hz)
        frequency = np.arange(FRAGMENT_SAMPLES) * RATE_HZ / FRAGMENT_SAMPLES
        frequency -= RATE_HZ * (frequency >= RATE_HZ / 2)
        frequency += info.carrier_hz
        inside = np.flatnonzero((frequency > low) & (frequency < high))
        self._bins = inside[np.argsort(frequency[inside])]
        self.frequency_hz = frequency[self._bins]
        cycles = np.outer(np.arange(FRAGMENT_SAMPLES), -self._bins / FRAGMENT_SAMPLES)
        self._to_spectrum = phasor(cycles) * gate()[:, None]
        self._inverse = self._division(matched_filter, chirp)
        # A fragment's middle is time zero: half its length later every other line has its sign
        # changed.
        self._inverse *= 1 - 2 * (self._bins % 2)
        self._sensor_db = np.interp(self.frequency_hz, _SENSOR_HZ, _SENSOR_DB)
        self._absorption_db_m = Air(air.temperature_c, _HUMIDITY_PERCENT).absorption_db_m(
            self.frequency_hz
        )
        self._wavenumber = 2 * np.pi * self.frequency_hz / air.speed_of_sound_m_s
        self._to_bins = _shares(self._bins.size)
        offset = self.frequency_hz - (low + high) / 2
        self._taper = np.sin(np.pi * (self.frequency_hz - low) / (high - low))
        self._to_search = phasor(np.outer(offset, _SEARCH_S))
        self._to_lags = phasor(np.outer(offset, _LAGS_S))
        self._to_delays = np.cos(2 * np.pi * np.outer(offset, _DELAYS_S))
        self._to_delays_sine = np.sin(2 * np.pi * np.outer(offset, _DELAYS_S))
        self._offset_hz = offset

    def _division(self, matched_filter: MatchedFilter, chirp: Float) -> Float:
        """What undoes chirp and matched filter at each frequency, regularised."""
        num_samples = matched_filter.num_samples
        start = num_samples // 2
        audio = np.zeros((1, num_samples), np.float32)
        audio[0, start : start + chirp.size] = chirp
        peak = round(start * RATE_HZ / 450e3)
        first = peak - FRAGMENT_SAMPLES // 2
        alone = matched_filter(audio)[0, first : first + FRAGMENT_SAMPLES]
        strength = np.abs(scipy.fft.fft(alone))[self._bins].astype(np.float64)
        undone = strength / (strength**2 + (_REGULARISER * strength.max()) ** 2)
        return np.asarray(undone)

    def __call__(
        self, fragments: Complex, coherence: Float, places: Places
    ) -> npt.NDArray[np.float32]:
        """Features, float32, shape (n, NUM_FEATURES).

        Parameters
        ----------
        fragments : complex64, shape (n, FRAGMENT_SAMPLES)
            Beams toward ``places``, their located peak in the middle.
        coherence : shape (n, num_subbands)
            As from ``array_coherence``.
        places : Places
        """
        spectrum = self.reflectivity(fragments, places)
        power = np.abs(spectrum) ** 2
        level_db = _decibel(power @ self._to_bins)
        tapered = spectrum * self._taper
        around = np.abs(tapered @ self._to_search)
        shift_s = _SEARCH_S[around.argmax(axis=1)]
        aligned = tapered * phasor(np.outer(shift_s, self._offset_hz))
        envelope = np.abs(aligned @ self._to_lags)
        peak = around.max(axis=1, keepdims=True) + 1e-12
        tapered_power = np.abs(tapered) ** 2
        correlation = np.hypot(
            tapered_power @ self._to_delays, tapered_power @ self._to_delays_sine
        ) / (tapered_power.sum(axis=1, keepdims=True) + 1e-20)
        scalars = (
            2 * _decibel(peak[:, 0]),
            places.snr_db,
            places.range_m,
            10 * np.abs(places.azimuth_rad),
            10 * places.elevation_rad,
            _decibel(power.mean(axis=1)),
            shift_s / _STEP_S,
        )
        return np.concatenate(
            [
                np.stack(scalars, axis=1),
                level_db - level_db.mean(axis=1, keepdims=True),
                20 * np.log10(envelope / peak + 0.01),
                correlation,
                coherence,
            ],
            axis=1,
        ).astype(np.float32)

    def reflectivity(self, fragments: Complex, places: Places) -> Complex:
        """Spectra of the reflectors themselves, over the band; shape (n, num_frequencies).

        Scattering length times a constant of the sensor's loudness.
        """
        spectrum = fragments @ self._to_spectrum
        cosine = np.cos(places.azimuth_rad) * np.cos(places.elevation_rad)
        sine = np.sqrt(np.maximum(1 - cosine**2, 0))
        pattern = np.abs(piston_pattern(self._wavenumber[None, :], sine[:, None]))
        gain_db = self._sensor_db - np.outer(2 * places.range_m, self._absorption_db_m)
        gain_db += 20 * np.log10(np.maximum(pattern, _LEAST_PATTERN))
        lift = 10 ** (-np.maximum(gain_db, _LEAST_GAIN_DB) / 20) * places.range_m[:, None] ** 2
        return np.asarray((spectrum * (self._inverse * lift)).astype(np.complex64))


def _shares(num_frequencies: int) -> Float:
    """What part of each bin's width each frequency has; shape (num_frequencies, NUM_BINS)."""
    frequency = np.arange(num_frequencies)[:, None]
    edges = np.linspace(0, num_frequencies, NUM_BINS + 1)
    shared = np.minimum(frequency + 1, edges[1:]) - np.maximum(frequency, edges[:-1])
    shared = np.maximum(shared, 0.0)
    return np.asarray(shared / shared.sum(axis=0))


def _decibel(power: Float) -> Float:
    return np.asarray(10 * np.log10(power + 1e-12))


def array_coherence(focus: Focus, baseband: Complex, points_m: Float) -> Float:
    """Part of the microphones' energy that a beam collects, by subband.

    1 for one point in silence, 1/32 for noise; a cluster of reflectors falls off with frequency.

    Parameters
    ----------
    focus : Focus
    baseband : complex64, shape (num_mics, num_samples)
    points_m : shape (num_points, 3)

    Returns
    -------
    shape (num_points, num_subbands)
    """
    delays_s = focus.delays_s(points_m)
    heard = focus.subbands(baseband, delays_s, *_subbands(focus.info.half_band_hz))
    together = np.abs(heard.sum(axis=1)) ** 2
    each = np.sum(heard.real**2 + heard.imag**2, axis=1)
    return np.asarray(together / (heard.shape[1] * each + 1e-20), np.float64)


@cache
def _subbands(half_band_hz: float) -> tuple[Float, Complex]:
    """Frequencies, and what takes a window to its parts there, shape (window, num_subbands)."""
    time_s = np.arange(_COHERENCE_SAMPLES) / RATE_HZ
    subbands_hz = half_band_hz * _SUBBANDS
    taper = hann(_COHERENCE_SAMPLES)[:, None]
    return subbands_hz, phasor(-np.outer(time_s, subbands_hz)) * taper
