"""Matched filter and energyscape: what returns from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.sparse

RATE_HZ = 450_000.0
RANGE_STRIDE = 16  # audio samples a range cell: 6.1 mm, about the compressed pulse
NUM_DIRECTIONS = 91
MAX_AZIMUTH_RAD = np.deg2rad(60.0)
MIN_RANGE_M = 0.5
# Kept from the chirp's own duration: nothing nearer than this can be told from the direct path.
_EDGE_SAMPLES = 96
_CELLS_PER_CHUNK = 256  # delayed rows of 2.5 MB: they stay in cache

Complex = npt.NDArray[np.complex64]
Float = npt.NDArray[np.float64]


def unit_vectors(azimuth_rad: Float, elevation_rad: Float) -> Float:
    """Directions in the sensor frame (x forward, y left, z up), shape (..., 3)."""
    azimuth_rad, elevation_rad = np.broadcast_arrays(azimuth_rad, elevation_rad)
    flat = np.cos(elevation_rad)
    return np.stack(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)], axis=-1
    )


def plane() -> tuple[Float, Float]:
    """Azimuths and elevations of 91 directions at the sonar's own height, left last.

    Even steps in the sine: there the beam is equally wide everywhere.
    """
    sine = np.linspace(-np.sin(MAX_AZIMUTH_RAD), np.sin(MAX_AZIMUTH_RAD), NUM_DIRECTIONS)
    return np.arcsin(sine), np.zeros(NUM_DIRECTIONS)


class MatchedFilter:
    """Correlates audio with the chirp; the result is complex, at 450 kHz, around zero frequency.

    Not for use by two threads at once.

    Parameters
    ----------
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    num_samples : int
        Audio samples a ping.
    band_hz : (low, high)
        Frequencies kept; outside it a sensor hears nothing of its chirp.
    """

    def __init__(self, chirp: Float, num_samples: int, band_hz: tuple[float, float]) -> None:
        self.num_samples = num_samples
        spacing = RATE_HZ / num_samples
        self._bins = np.arange(int(band_hz[0] / spacing), int(band_hz[1] / spacing) + 1)
        self.carrier_bin = int(self._bins.mean())
        self.carrier_hz = self.carrier_bin * spacing
        spectrum = scipy.fft.rfft(chirp, num_samples)[self._bins]
        edge = np.minimum(np.arange(spectrum.size), np.arange(spectrum.size)[::-1]) * spacing
        taper = np.sin(np.pi / 2 * np.clip(edge / 5e3, 0, 1)) ** 2
        # Unit noise gain: white noise of unit power comes out with unit power a sample.
        weight = np.conj(spectrum) * taper
        weight *= np.sqrt(num_samples / np.sum(np.abs(weight) ** 2))
        self._weight = weight.astype(np.complex64)
        # The direct path fills the chirp's own duration; blanking it also keeps the circular
        # correlation free of wrap-around, as the chirp is no longer than the blank.
        self.blank = chirp.size + _EDGE_SAMPLES
        self._fade = np.zeros(self.blank, np.float32)
        # Kept from ping to ping: fresh memory costs more than the arithmetic on it.
        self._faded = np.empty((0, num_samples), np.float32)
        self._kept = np.zeros((0, num_samples), np.complex64)
        ramp = np.arange(_EDGE_SAMPLES) / _EDGE_SAMPLES
        self._fade[-_EDGE_SAMPLES:] = np.sin(np.pi / 2 * ramp) ** 2

    def __call__(self, audio: npt.NDArray[np.float32]) -> Complex:
        """Compress ``audio``, float32 (num_mics, num_samples), to complex64 of the same shape."""
        if len(self._kept) != len(audio):
            self._faded = np.empty_like(audio)
            self._kept = np.zeros((len(audio), self.num_samples), np.complex64)
        faded, kept = self._faded, self._kept
        np.multiply(audio[:, : self.blank], self._fade, out=faded[:, : self.blank])
        faded[:, self.blank :] = audio[:, self.blank :]
        spectrum = scipy.fft.rfft(faded, axis=1)
        first, count = int(self._bins[0]), self._bins.size
        middle = self.carrier_bin - first
        above = spectrum[:, self.carrier_bin : first + count]
        np.multiply(above, self._weight[middle:], out=kept[:, : count - middle])
        below = spectrum[:, first : self.carrier_bin]
        np.multiply(below, self._weight[:middle], out=kept[:, -middle:])
        return np.asarray(scipy.fft.ifft(kept, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class Energyscape:
    """Power over direction and range.

    power : float32, shape (num_directions, num_ranges)
        Of the beamformed, compressed echo; noise of one microphone gives 1 / 32.
    azimuth_rad, elevation_rad : shape (num_directions,)
    range_m : shape (num_ranges,)
    """

    power: npt.NDArray[np.float32]
    azimuth_rad: Float
    elevation_rad: Float
    range_m: Float

    def noise_floor(self) -> float:
        """Power where nothing returns: a low quantile of the far ranges, the quietest of a room.

        The last tenth is left out: there the frame ends within the chirp.
        """
        num_ranges = self.power.shape[1]
        tail = self.power[::3, num_ranges * 6 // 10 : num_ranges * 9 // 10]
        return float(np.quantile(tail, 0.2)) / 0.223 + 1e-20  # exponential law: 20 % lie under this


class Imager:
    """Energyscape by one sparse product over delayed baseband rows.

    Delays are rounded to the 450 kHz grid, their phases are not.

    Parameters
    ----------
    mic_positions_m : shape (num_mics, 3)
    carrier_hz : float
        Of the baseband.
    num_samples : int
        Of the baseband.
    speed_of_sound_m_s : float
    azimuth_rad, elevation_rad : shape (num_directions,)
        Where to look; ``plane()`` looks to 91 directions at the sonar's own height.
    """

    def __init__(
        self,
        mic_positions_m: Float,
        carrier_hz: float,
        num_samples: int,
        speed_of_sound_m_s: float,
        azimuth_rad: Float,
        elevation_rad: Float,
    ) -> None:
        self.azimuth_rad, self.elevation_rad = azimuth_rad, elevation_rad
        toward = unit_vectors(azimuth_rad, elevation_rad)
        early_s = toward @ mic_positions_m.T / speed_of_sound_m_s  # nearer microphones hear first
        shift = np.rint(-early_s * RATE_HZ).astype(int)
        margin = int(np.abs(shift).max()) + 1
        start = int(2 * MIN_RANGE_M / speed_of_sound_m_s * RATE_HZ)
        start = max(-(-start // RANGE_STRIDE), -(-margin // RANGE_STRIDE)) * RANGE_STRIDE
        cells = (num_samples - margin - start) // RANGE_STRIDE - 1
        self.range_m = (start + RANGE_STRIDE * np.arange(cells)) / RATE_HZ * speed_of_sound_m_s / 2
        self._cells = cells
        num_mics = len(mic_positions_m)
        self._columns = num_samples // RANGE_STRIDE
        # Row (mic, shift) of the delayed matrix begins here in the polyphase copy of the baseband.
        pairs, column = np.unique(
            (np.arange(num_mics)[None, :] * 100_000 + shift + 50_000).ravel(), return_inverse=True
        )
        first = start + pairs % 100_000 - 50_000
        self._offsets = (
            pairs // 100_000 * RANGE_STRIDE + first % RANGE_STRIDE
        ) * self._columns + first // RANGE_STRIDE
        weight = np.exp(-2j * np.pi * carrier_hz * early_s).astype(np.complex64) / num_mics
        self._steering = scipy.sparse.csr_array(
            (weight.ravel(), column.ravel(), np.arange(len(toward) + 1) * num_mics),
            shape=(len(toward), pairs.size),
        )

    def __call__(self, baseband: Complex) -> Energyscape:
        """Image ``baseband``, complex64 (num_mics, num_samples)."""
        num_mics = len(baseband)
        phases = np.ascontiguousarray(
            baseband[:, : self._columns * RANGE_STRIDE]
            .reshape(num_mics, self._columns, RANGE_STRIDE)
            .transpose(0, 2, 1)
        ).ravel()
        power = np.empty((self._steering.shape[0], self._cells), np.float32)
        for first in range(0, self._cells, _CELLS_PER_CHUNK):
            count = min(_CELLS_PER_CHUNK, self._cells - first)
            delayed = np.lib.stride_tricks.sliding_window_view(phases, count)
            beams = self._steering @ delayed[self._offsets + first]
            np.add(beams.real**2, beams.imag**2, out=power[:, first : first + count])
        return Energyscape(power, self.azimuth_rad, self.elevation_rad, self.range_m)


class Focus:
    """Beamforms the baseband on single points, spherical wavefronts and all."""

    def __init__(
        self,
        mic_positions_m: Float,
        emitter_position_m: Float,
        carrier_hz: float,
        speed_of_sound_m_s: float,
    ) -> None:
        self.mics, self.emitter = mic_positions_m, emitter_position_m
        self.carrier_hz, self.c = carrier_hz, speed_of_sound_m_s

    def delays_s(self, points_m: Float) -> Float:
        """Two-way travel times emitter -> point -> microphones, shape (num_points, num_mics)."""
        out = np.linalg.norm(points_m - self.emitter, axis=-1)
        back = np.linalg.norm(points_m[:, None, :] - self.mics, axis=-1)
        return np.asarray((out[:, None] + back) / self.c)

    def windows(
        self, baseband: Complex, delays_s: Float, before: int, length: int
    ) -> tuple[Complex, Float]:
        """Each microphone's sound around its own delay, in phase with the others.

        Parameters
        ----------
        baseband : complex64, shape (num_mics, num_samples)
        delays_s : shape (num_points, num_mics)
        before, length : int
            Sample ``before`` of each window is nearest to the delay. Silence beyond the frame.

        Returns
        -------
        complex64, shape (num_points, num_mics, length), and what rounding left of each delay, s
        """
        nearest = np.rint(delays_s * RATE_HZ).astype(np.intp)
        first = nearest - before
        mic = np.arange(len(self.mics))[None, :]
        if first.min() >= 0 and first.max() <= baseband.shape[1] - length:
            rows = np.lib.stride_tricks.sliding_window_view(baseband, length, axis=1)
            pieces = rows[mic, first]
        else:
            index = first[:, :, None] + np.arange(length)
            valid = (index >= 0) & (index < baseband.shape[1])
            inside = np.clip(index, 0, baseband.shape[1] - 1)
            pieces = baseband[mic[:, :, None], inside] * valid
        turn = np.exp(2j * np.pi * self.carrier_hz * delays_s).astype(np.complex64)
        pieces *= turn[:, :, None]
        return pieces, delays_s - nearest / RATE_HZ

    def beam(self, baseband: Complex, points_m: Float, before: int, length: int) -> Complex:
        """The sound from each point, shape (num_points, length), at 450 kHz.

        Sample ``before`` is the point's own two-way time, rounded. Silence beyond the frame.
        """
        pieces, _ = self.windows(baseband, self.delays_s(points_m), before, length)
        return np.asarray(pieces.mean(axis=1))
