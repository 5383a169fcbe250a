"""What the classifier sees of a fragment: after the paper, 20 spectral bins, 30-100 kHz.

The text leaves open which microphone is taken, the taper, the filter and the scaling. Here: the
beam toward the proposal, after pulse compression (the raw crop is shorter than the chirp and shows
the chirp rather than the dish), a Hann taper, decibels; spreading, absorption and the emitter's
beam pattern are taken out, so that the level is the reflector's. Products of the bins go with
them: a size shows in how bins differ together, which a linear classifier cannot see otherwise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.fragment import taper
from ertis_detector.imaging import AUDIO_RATE_HZ, RATE_HZ
from ertis_detector.piston import piston_pattern

FEATURE_VERSION = "paper20-db-pairs-1"  # stored in models: other versions do not fit
BAND_HZ = (30e3, 100e3)
NUM_BINS = 20
NUM_FEATURES = NUM_BINS + NUM_BINS * (NUM_BINS + 1) // 2
_EDGES_HZ = np.linspace(*BAND_HZ, NUM_BINS + 1)
_CENTRES_HZ = (_EDGES_HZ[1:] + _EDGES_HZ[:-1]) / 2
_NOMINAL_AIR = Air(20.0, 50.0)
_ABSORPTION_DB_M = _NOMINAL_AIR.absorption_db_m(_CENTRES_HZ)
_WAVENUMBER = 2 * np.pi * _CENTRES_HZ / _NOMINAL_AIR.speed_of_sound_m_s
_LEAST_PATTERN = 0.1  # near the emitter's nulls nothing can be made good
_FLOOR_DB = -50.0  # under the strongest bin: where chirp and sensor leave only noise
_UPPER = np.triu_indices(NUM_BINS)


def features(
    fragments: npt.NDArray[np.complex64],
    carrier_hz: float,
    range_m: npt.NDArray[np.float64],
    azimuth_rad: npt.NDArray[np.float64],
    elevation_rad: npt.NDArray[np.float64],
) -> npt.NDArray[np.float32]:
    """What the classifier sees of fragments.

    Parameters
    ----------
    fragments : complex64, shape (n, num_samples)
        Baseband around ``carrier_hz``.
    carrier_hz : float
    range_m, azimuth_rad, elevation_rad : shape (n,)
        Where each fragment was heard.

    Returns
    -------
    float32, shape (n, NUM_FEATURES)
        The 20 bins (10 dB are one), then their pairwise products.
    """
    level = spectral_bins(fragments, carrier_hz)
    level += (2 * range_m[:, None]) * _ABSORPTION_DB_M + 40 * np.log10(range_m)[:, None]
    cosine = np.cos(azimuth_rad) * np.cos(elevation_rad)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    pattern = np.abs(piston_pattern(_WAVENUMBER[None, :], sine[:, None]))
    level -= 20 * np.log10(np.maximum(pattern, _LEAST_PATTERN))
    tens = np.clip(level / 10, -3, 7)
    products = tens[:, _UPPER[0]] * tens[:, _UPPER[1]]
    return np.concatenate([tens, products], axis=1).astype(np.float32)


def spectral_bins(
    fragments: npt.NDArray[np.complex64], carrier_hz: float
) -> npt.NDArray[np.float64]:
    """Mean FFT magnitude of tapered fragments in each bin, dB; shape (n, 20)."""
    num_samples = fragments.shape[1]
    magnitude = np.abs(scipy.fft.fft(taper(fragments), axis=1)).astype(np.float64)
    magnitude *= AUDIO_RATE_HZ / RATE_HZ  # as if every audio sample were summed
    first = np.rint((_EDGES_HZ - carrier_hz) / (RATE_HZ / num_samples)).astype(int)
    ordered = magnitude[:, np.arange(first[0], first[-1]) % num_samples]
    mean = np.add.reduceat(ordered, first[:-1] - first[0], axis=1) / np.diff(first)
    decibel = 20 * np.log10(np.maximum(mean, 1e-12))
    return np.asarray(np.maximum(decibel, decibel.max(axis=1, keepdims=True) + _FLOOR_DB))
