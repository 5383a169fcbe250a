"""Sound that nobody asked for: machines, air guns, other sonars; each far away in one direction.

Added at the microphones as plane waves, coherent over the array: beamforming points to them.
Levels are dBFS of one microphone: a sine of full scale has -3 dBFS RMS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.sensor_response import shipped_response
from ertis_simulator.spectrum_kernels import add_plane_wave

FloatArray = npt.NDArray[np.float64]

HARMONICS_DB = (0.0, -8.0, -14.0, -18.0)  # assumed: of a whine, the fundamental first
DRIFT = 0.002  # assumed: a machine's speed differs so much from ping to ping, relative
_GUN_RISE_S = 0.2e-3  # assumed
MARGIN = 256  # audio samples before and behind what is heard: the array is 65 wide, sines ring


class NoiseSource(Protocol):
    """Something that makes sound on its own."""

    @property
    def azimuth_rad(self) -> float:
        """Where it is, world frame, seen from the sonar."""

    def waveform(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """What one microphone gets of it during a ping, shape (num_samples,), 450 kHz."""


@dataclass(frozen=True, slots=True)
class Tone:
    """A machine's hum or whine: a tone with harmonics, at random phase."""

    frequency_hz: float
    level_dbfs: float
    azimuth_rad: float = 0.0

    def waveform(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw phases and a little drift of speed."""
        time_s = np.arange(num_samples) / AUDIO_RATE_HZ
        base_hz = self.frequency_hz * (1 + DRIFT * rng.normal())
        made = np.zeros(num_samples)
        for number, level_db in enumerate(HARMONICS_DB, 1):
            phase = rng.uniform(0, 2 * np.pi)
            if number * base_hz < AUDIO_RATE_HZ / 2:
                tone = np.sin(2 * np.pi * number * base_hz * time_s + phase)
                made += 10 ** (level_db / 20) * tone
        return np.asarray(made * np.sqrt(2.0) * 10 ** (self.level_dbfs / 20))


@dataclass(frozen=True, slots=True)
class AirGun:
    """Bursts of broadband hiss; ``level_dbfs`` is the RMS while one lasts."""

    level_dbfs: float
    bursts_per_s: float = 2.0
    duration_s: float = 0.15
    azimuth_rad: float = 0.0

    def waveform(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw when it blows: often not at all within one ping."""
        made = np.zeros(num_samples)
        time_s = np.arange(num_samples) / AUDIO_RATE_HZ
        span_s = num_samples / AUDIO_RATE_HZ + self.duration_s
        for _ in range(rng.poisson(self.bursts_per_s * span_s)):
            since = time_s - rng.uniform(-self.duration_s, num_samples / AUDIO_RATE_HZ)
            rise = np.clip(since / _GUN_RISE_S, 0, 1)
            fall = np.clip((self.duration_s - since) / _GUN_RISE_S, 0, 1)
            made += rise * fall * rng.standard_normal(num_samples)
        spectrum = scipy.fft.rfft(made)
        spectrum *= shipped_response().amplitude(scipy.fft.rfftfreq(num_samples, 1 / AUDIO_RATE_HZ))
        return np.asarray(10 ** (self.level_dbfs / 20) * scipy.fft.irfft(spectrum, num_samples))


@dataclass(frozen=True, slots=True)
class OtherSonar:
    """Another sonar's chirps, at random phase; ``level_dbfs`` is the RMS of one."""

    level_dbfs: float
    pings_per_s: float = 10.0
    chirp: Chirp = DEFAULT_CHIRP
    azimuth_rad: float = 0.0

    def waveform(self, num_samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw when it pings."""
        period = AUDIO_RATE_HZ / self.pings_per_s
        samples = self.chirp.samples(AUDIO_RATE_HZ)
        samples = samples / max(float(np.sqrt(np.mean(samples**2))), 1e-9)
        made = np.zeros(num_samples)
        for start in np.arange(rng.uniform(-period, 0), num_samples, period).astype(int):
            first, stop = max(start, 0), min(start + samples.size, num_samples)
            if stop > first:
                made[first:stop] += samples[first - start : stop - start]
        return np.asarray(made * 10 ** (self.level_dbfs / 20))


def add_sources(
    spectrum: npt.NDArray[np.complex64],
    size: int,
    num_samples: int,
    sources: Sequence[NoiseSource],
    yaw_rad: float,
    mics_m: FloatArray,
    speed_m_s: float,
    rng: np.random.Generator,
) -> None:
    """Add them to the spectra of audio at 450 kHz, in place.

    Parameters
    ----------
    spectrum : complex64, shape (num_mics, size // 2 + 1)
    size : int
        Samples that the spectrum stands for, ``num_samples + 2 * MARGIN`` at least.
    num_samples : int
        Those of them that are heard.
    yaw_rad : float
        The sonar's heading.
    mics_m : shape (num_mics, 3)
        Sensor frame.
    """
    for source in sources:
        waveform = source.waveform(num_samples + 2 * MARGIN, rng).astype(np.float32)
        around = np.zeros(size, np.float32)
        around[: num_samples + MARGIN] = waveform[MARGIN:]
        around[-MARGIN:] = waveform[:MARGIN]
        bearing = source.azimuth_rad - yaw_rad
        early_s = mics_m @ np.array([np.cos(bearing), np.sin(bearing), 0.0]) / speed_m_s
        turn_a_bin = 2 * np.pi * AUDIO_RATE_HZ / size * early_s
        add_plane_wave(spectrum, scipy.fft.rfft(around), turn_a_bin)
