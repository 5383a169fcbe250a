"""Microphones: noise, spread of gain and phase, 4th-order sigma-delta PDM, known defects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_driver.audio_filter import TAPS, UNITY
from ertis_driver.frame import DECIMATION, NUM_MICS
from ertis_simulator.kernels import sigma_delta

NOISE_DBFS_PER_HZ = -101.0  # a real ping: -99 to -104 between 25 and 115 kHz
GAIN_SPREAD_DB = 1.6  # standard deviation would be half: this is what a real ping spans
PHASE_SPREAD_RAD = np.deg2rad(10.0)
# Noise transfer (1 - z^-1)^4 / A(z), Butterworth poles, out-of-band gain 1.5.
_NTF_ZEROS = np.array([-4.0, 6.0, -4.0, 1.0])
_NTF_POLES = np.array([-3.194364316, 3.892021388, -2.135836365, 0.444444598])


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
        gain_db = rng.uniform(-GAIN_SPREAD_DB / 2, GAIN_SPREAD_DB / 2, NUM_MICS)
        phase = rng.normal(0, PHASE_SPREAD_RAD / 2, NUM_MICS)
        return cls((10 ** (gain_db / 20) * np.exp(1j * phase)).astype(np.complex64))


def add_noise(pressure: npt.NDArray[np.float32], rng: np.random.Generator) -> None:
    """Add the microphones' own noise to ``(32, n)`` audio at 450 kHz, in place."""
    sigma = 10 ** (NOISE_DBFS_PER_HZ / 20) * np.sqrt(450e3 / 2)
    pressure += np.float32(sigma) * rng.standard_normal(pressure.shape, dtype=np.float32)


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
    taps = TAPS.size // DECIMATION
    prototype = (TAPS / UNITY * DECIMATION).astype(np.float32)
    phases = np.ascontiguousarray(prototype.reshape(taps, DECIMATION).T[:, ::-1])
    lead = taps // 2
    padded = np.zeros((pressure.shape[1] + taps - 1, NUM_MICS), np.float32)
    # The centre of the filter falls on the sample, so that audio out is in step with audio in.
    padded[lead - 1 : lead - 1 + pressure.shape[1]] = pressure.T
    words = np.empty(pressure.shape[1] * DECIMATION, np.uint32)
    state = rng.uniform(-0.5, 0.5, (8, NUM_MICS)).astype(np.float32)
    sigma_delta(
        padded,
        phases,
        (_NTF_ZEROS - _NTF_POLES).astype(np.float32),
        _NTF_POLES.astype(np.float32),
        state,
        words,
    )
    return words


def corrupt_half_words(
    words: npt.NDArray[np.uint32], mean_count: float, rng: np.random.Generator
) -> None:
    """What the firmware does now and then: a high half carries the low half of the next word."""
    positions = rng.integers(1, words.size - 1, rng.poisson(mean_count))
    low_next = (words[positions + 1] & np.uint32(0xFFFF)) << np.uint32(16)
    words[positions] = (words[positions] & np.uint32(0xFFFF)) | low_next
    words[0] = (words[1] & np.uint32(0xFFFF)) * np.uint32(0x10001)  # start-up garbage
