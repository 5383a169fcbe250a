"""Microphones: noise, spread of gain and phase, 4th-order sigma-delta PDM, known defects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_driver.audio_filter import TAPS, UNITY
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION, NUM_MICS
from ertis_simulator.pdm_kernel import INTERPOLATION_TAPS, sigma_delta
from ertis_simulator.spectrum_kernels import BYTES_VARIANCE, add_shaped_noise

# Standard deviations that two echoes of one real ping have in common (docs/validation.md).
GAIN_SPREAD_DB = 1.0
PHASE_SPREAD_RAD = np.deg2rad(4.0)
# Noise transfer B(z) / A(z): two zeros at 0 Hz and two at 115 kHz, Butterworth poles, out-of-band
# gain 1.55. It is within 4 dB of a real ping from 60 kHz to 2 MHz. Without the zeros at 115 kHz it
# would be 6 dB too loud at 120 to 160 kHz; a gain of 2.3 alone fits as well, but fails from half of
# full scale on, where the real microphone does not.
_NTF_ZEROS = np.array([-3.974272530, 5.948545060, -3.974272530, 1.000000000])
_NTF_POLES = np.array([-3.117545668, 3.721567585, -2.006177625, 0.410896296])
# Before the decision, as part of its step; without, silence idles in tones that nobody has seen.
_DITHER = 0.15
_DITHER_WORDS = 4093  # before it repeats: 0.9 ms
_WARM_UP = 32  # audio samples: modulators run before the first word; 71 us settle any start


@dataclass(frozen=True, slots=True, eq=False)
class MicrophoneSet:
    """The 32 microphones of one particular sonar.

    response : complex64, shape (32,)
        Gain and phase against the ideal.
    half_words_per_frame : float
        Mean number of corrupt half-words in a default frame.
    """

    response: npt.NDArray[np.complex64]
    half_words_per_frame: float = 7.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> MicrophoneSet:
        """One set from the distribution of a production."""
        gain_db = rng.normal(0, GAIN_SPREAD_DB, NUM_MICS)
        phase = rng.normal(0, PHASE_SPREAD_RAD, NUM_MICS)
        return cls((10 ** (gain_db / 20) * np.exp(1j * phase)).astype(np.complex64))


@cache
def _noise_table() -> npt.NDArray[np.float64]:
    text = (resources.files("ertis_simulator") / "data/microphone_noise.csv").read_text()
    lines = [line for line in text.splitlines() if line[:1].isdigit()]
    return np.loadtxt(lines, delimiter=",")


def noise_density_db(frequency_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Noise before the modulator, dBFS/Hz, from ``data/microphone_noise.csv``; any shape."""
    table = _noise_table()
    return np.asarray(np.interp(frequency_hz, table[:, 0], table[:, 1]))


def add_noise_spectrum(
    spectrum: npt.NDArray[np.complex64], size: int, rng: np.random.Generator
) -> None:
    """Add the microphones' own noise to spectra, in place.

    Parameters
    ----------
    spectrum : complex64, shape (num_mics, size // 2 + 1)
        Of audio at 450 kHz.
    size : int
        Samples that the spectrum stands for.
    """
    bins_hz = scipy.fft.rfftfreq(size, 1 / AUDIO_RATE_HZ)
    # A bin of one-sided density d has the mean square size * rate * d / 2, half of it in each part.
    scale = 10 ** (noise_density_db(bins_hz) / 20)
    scale *= np.sqrt(size * AUDIO_RATE_HZ / (4 * BYTES_VARIANCE))
    random = rng.integers(0, 2**64, spectrum.shape, np.uint64).view(np.uint32)
    add_shaped_noise(spectrum, random, scale.astype(np.float32))


def add_noise(pressure: npt.NDArray[np.float32], rng: np.random.Generator) -> None:
    """Add the microphones' own noise to ``(32, n)`` audio at 450 kHz, in place."""
    num_mics, num_samples = pressure.shape
    size = scipy.fft.next_fast_len(num_samples, real=True)
    spectrum = np.zeros((num_mics, size // 2 + 1), np.complex64)
    add_noise_spectrum(spectrum, size, rng)
    pressure += scipy.fft.irfft(spectrum, size, axis=1, overwrite_x=True)[:, :num_samples]


@cache
def _interpolation() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Sums and differences of the mirrored taps of the first half of the phases."""
    prototype = TAPS / UNITY * DECIMATION
    phases = prototype.reshape(INTERPOLATION_TAPS, DECIMATION).T[: DECIMATION // 2, ::-1]
    mirrored = phases[:, ::-1]
    pairs = ((phases + sign * mirrored)[:, : INTERPOLATION_TAPS // 2] / 2 for sign in (1, -1))
    even, odd = (np.ascontiguousarray(part, np.float32) for part in pairs)
    return even, odd


def to_pdm(pressure: npt.NDArray[np.float32], rng: np.random.Generator) -> npt.NDArray[np.uint32]:
    """Audio to PDM words.

    Parameters
    ----------
    pressure : float32, shape (32, num_samples)
        At 450 kHz, full scale 1; beyond it the bits run equal, as a real microphone's do.
    rng
        Start of the modulators.

    Returns
    -------
    uint32, shape (10 * num_samples,)
    """
    taps, lead = INTERPOLATION_TAPS, INTERPOLATION_TAPS // 2
    num_samples = _WARM_UP + pressure.shape[1]
    padded = np.zeros((num_samples + taps - 1, NUM_MICS), np.float32)
    # The centre of the filter falls on the sample, so that audio out is in step with audio in.
    first = _WARM_UP + lead - 1
    padded[first : first + pressure.shape[1]] = pressure.T
    words = np.empty(num_samples * DECIMATION, np.uint32)
    dither = rng.random((_DITHER_WORDS, NUM_MICS), np.float32) * 2 - 1
    state = rng.uniform(-0.5, 0.5, (4, NUM_MICS)).astype(np.float32)
    sigma_delta(
        padded,
        *_interpolation(),
        (_NTF_ZEROS - _NTF_POLES).astype(np.float32),
        _NTF_POLES.astype(np.float32),
        state,
        np.float32(_DITHER) * dither,
        words,
    )
    return words[_WARM_UP * DECIMATION :]


def corrupt_half_words(
    words: npt.NDArray[np.uint32], mean_count: float, rng: np.random.Generator
) -> None:
    """What the firmware does now and then: a high half carries the low half of the next word."""
    positions = rng.integers(1, words.size - 1, rng.poisson(mean_count))
    low_next = (words[positions + 1] & np.uint32(0xFFFF)) << np.uint32(16)
    words[positions] = (words[positions] & np.uint32(0xFFFF)) | low_next
    words[0] = (words[1] & np.uint32(0xFFFF)) * np.uint32(0x10001)  # start-up garbage


def kill_microphones(words: npt.NDArray[np.uint32], rows: Iterable[int]) -> None:
    """Rest the data lines of dead microphones, in place: even rows low, odd rows high.

    Parameters
    ----------
    words : uint32, shape (num_words,)
    rows
        Rows of ``mic_positions_m``, 0 to 31.
    """
    for row in rows:
        bit = np.uint32(1 << row)
        if row % 2:
            words |= bit
        else:
            words &= ~bit
