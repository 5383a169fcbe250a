"""Which frequencies of a ping are computed: those at which its chirp is loud."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.echo_kernels import HALF_BAND, NUM_POLYNOMIALS
from ertis_simulator.sensor_response import SensorResponse

FloatArray = npt.NDArray[np.float64]

WIDEST_HZ = (10e3, 115e3)
LEFT_OUT = 10 ** (-75 / 10)  # of the chirp's energy, at either end of the band, as the sensor gives
_DECIMATIONS = range(3, 9)
_ROOM = 2_048  # audio samples behind the frame for the tails of the last echoes
_NODES = np.linspace(-1, 1, 32)


def band_hz(chirp: FloatArray, sensor: SensorResponse) -> tuple[float, float]:
    """Return the frequencies between which a chirp at 450 kHz is emitted and heard."""
    size = scipy.fft.next_fast_len(4 * chirp.size, real=True)
    frequency_hz = scipy.fft.rfftfreq(size, 1 / AUDIO_RATE_HZ)
    energy = np.abs(scipy.fft.rfft(chirp, size) * sensor.amplitude(frequency_hz)) ** 2
    energy[(frequency_hz < WIDEST_HZ[0]) | (frequency_hz > WIDEST_HZ[1])] = 0.0
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    inside = frequency_hz[(below > LEFT_OUT) & (below < 1 - LEFT_OUT)]
    return (float(inside[0]), float(inside[-1])) if inside.size else WIDEST_HZ


@dataclass(frozen=True, eq=False)
class Band:
    """Frequencies, sizes and grids of one ping.

    chirp : float64, shape (n,)
    num_samples : int
        Audio samples wanted.
    decimation : int
        From 450 kHz to the rate of the complex trains.
    length : int
        Of a train.
    carrier_bin : int
        Of the frequency that trains are around.
    """

    chirp: FloatArray
    num_samples: int
    sensor: SensorResponse
    decimation: int
    length: int
    carrier_bin: int

    @staticmethod
    def of(chirp: FloatArray, num_samples: int, sensor: SensorResponse) -> Band:
        """Choose the slowest trains that hold the chirp; the last ones are kept."""
        return Band._of(np.asarray(chirp, np.float64).tobytes(), num_samples, sensor)

    @staticmethod
    @lru_cache(maxsize=8)
    def _of(samples: bytes, num_samples: int, sensor: SensorResponse) -> Band:
        chirp = np.frombuffer(samples)
        low, high = band_hz(chirp, sensor)
        fitting = [d for d in _DECIMATIONS if 2 * HALF_BAND * AUDIO_RATE_HZ / d >= high - low]
        decimation = max(fitting, default=_DECIMATIONS[0])
        longest = chirp.size + math.ceil(sensor.longest_delay_s * AUDIO_RATE_HZ)
        total = num_samples + max(_ROOM, longest + 64)
        length = 2 * scipy.fft.next_fast_len(-(-total // (2 * decimation)))
        half = HALF_BAND * AUDIO_RATE_HZ / decimation
        centre = max((low + high) / 2, half + WIDEST_HZ[0] / 2)
        carrier_bin = round(centre * decimation * length / AUDIO_RATE_HZ)
        return Band(chirp, num_samples, sensor, decimation, length, carrier_bin)

    @property
    def fft_size(self) -> int:
        """Audio samples of a whole turn."""
        return self.length * self.decimation

    @property
    def rate_hz(self) -> float:
        """Of the trains."""
        return AUDIO_RATE_HZ / self.decimation

    @property
    def carrier_hz(self) -> float:
        """That the trains are around."""
        return self.carrier_bin * AUDIO_RATE_HZ / self.fft_size

    @cached_property
    def bins(self) -> npt.NDArray[np.int64]:
        """Those of the audio's spectrum that are computed."""
        half = int(HALF_BAND * self.length)
        return np.arange(self.carrier_bin - half, self.carrier_bin + half + 1)

    @cached_property
    def emitted(self) -> npt.NDArray[np.complex64]:
        """Spectrum of the chirp as the sensor gives it, at ``bins``."""
        bins = self.bins
        frequency_hz = np.asarray(bins * (AUDIO_RATE_HZ / self.fft_size), np.float64)
        shape = self.sensor.response(frequency_hz)
        return np.asarray(scipy.fft.rfft(self.chirp, self.fft_size)[bins] * shape, np.complex64)

    @cached_property
    def nodes_hz(self) -> FloatArray:
        """Where echoes' spectra are sampled, evenly over the band."""
        return np.asarray(self.carrier_hz + _NODES * HALF_BAND * self.rate_hz)

    @cached_property
    def fit(self) -> FloatArray:
        """From spectra at ``nodes_hz`` to polynomials, shape (num_nodes, NUM_POLYNOMIALS).

        Least squares, weighed by what is emitted and heard.
        """
        grid_hz = scipy.fft.rfftfreq(self.fft_size, 1 / AUDIO_RATE_HZ)
        emitted = np.abs(scipy.fft.rfft(self.chirp, self.fft_size))
        nodes_hz = self.nodes_hz
        trust = np.interp(nodes_hz, grid_hz, emitted) * self.sensor.amplitude(nodes_hz)
        trust = np.maximum(trust / max(float(trust.max()), 1e-12), 1e-3)
        polynomials = np.polynomial.chebyshev.chebvander(_NODES, NUM_POLYNOMIALS - 1)
        return np.asarray((np.linalg.pinv(polynomials * trust[:, None]) * trust).T)
