"""Matched filter and energyscape: what returns from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

AUDIO_RATE_HZ = 450_000.0
# Complex, around the chirp's carrier: room for the sensor's 70 kHz, and for delays between samples.
_KEPT, _OF = 3, 8
RATE_HZ = AUDIO_RATE_HZ * _KEPT / _OF
RANGE_STRIDE = 6  # baseband samples a range cell: 6.1 mm, about the compressed pulse
NUM_DIRECTIONS = 91
MAX_AZIMUTH_RAD = np.deg2rad(60.0)
MIN_RANGE_M = 0.5
# Kept from the chirp's own duration: nothing nearer than this can be told from the direct path.
_EDGE_SAMPLES = 96
_BLOCK_DIRECTIONS = 13  # neighbours hear a microphone at nearly the same time: they share its rows

Complex = npt.NDArray[np.complex64]
Float = npt.NDArray[np.float64]


def unit_vectors(azimuth_rad: Float, elevation_rad: Float) -> Float:
    """Directions in the sensor frame (x forward, y left, z up), shape (..., 3)."""
    flat = np.cos(elevation_rad)
    forward = flat * np.cos(azimuth_rad)
    vectors = np.empty((*forward.shape, 3))
    vectors[..., 0] = forward
    vectors[..., 1] = flat * np.sin(azimuth_rad)
    vectors[..., 2] = np.sin(elevation_rad)
    return vectors


def phasor(cycles: npt.NDArray[np.floating]) -> Complex:
    """``e^{2 pi i cycles}`` as complex64, of any shape; much faster than a complex exponential."""
    angle = (cycles - np.rint(cycles)).astype(np.float32)
    angle *= np.float32(2 * np.pi)
    turned = np.empty(angle.shape, np.complex64)
    np.cos(angle, out=turned.real)
    np.sin(angle, out=turned.imag)
    return turned


def plane() -> tuple[Float, Float]:
    """Azimuths and elevations of 91 directions at the sonar's own height, left last.

    Even steps in the sine: there the beam is equally wide everywhere.
    """
    sine = np.linspace(-np.sin(MAX_AZIMUTH_RAD), np.sin(MAX_AZIMUTH_RAD), NUM_DIRECTIONS)
    return np.arcsin(sine), np.zeros(NUM_DIRECTIONS)


@dataclass(frozen=True, slots=True)
class BasebandInfo:
    """What a matched filter makes of audio.

    carrier_hz, half_band_hz : float
        What became zero frequency, and how far the chirp reaches from there.
    num_samples : int
        A ping, at ``RATE_HZ``: as many as a whole chirp returns in.
    """

    carrier_hz: float
    half_band_hz: float
    num_samples: int


class MatchedFilter:
    """Correlates audio with the chirp; the result is complex, at 169 kHz, around zero frequency.

    Not for use by two threads at once.

    Parameters
    ----------
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    num_samples : int
        Audio samples a ping.
    band_hz : (low, high)
        Frequencies kept; outside it a sensor hears nothing of its chirp.

    Attributes
    ----------
    baseband : BasebandInfo
    """

    def __init__(self, chirp: Float, num_samples: int, band_hz: tuple[float, float]) -> None:
        self.num_samples = num_samples
        # The direct path fills the chirp's own duration.
        self.blank = chirp.size + _EDGE_SAMPLES
        # The blank is as good as padding: what the transform is too short for is folded into it,
        # where the chirps that return last look for it.
        least = num_samples - chirp.size
        self._length = _OF * int(scipy.fft.next_fast_len(-(-least // _OF)))
        self._tail = max(num_samples - self._length, 0)
        spacing = AUDIO_RATE_HZ / self._length
        bins = np.arange(int(band_hz[0] / spacing), int(band_hz[1] / spacing) + 1)
        carrier_bin = int(bins.mean())
        self.baseband = BasebandInfo(
            carrier_bin * spacing, spacing * bins.size / 2, self._length * _KEPT // _OF
        )
        self._above = slice(carrier_bin, int(bins[-1]) + 1)
        self._below = slice(int(bins[0]), carrier_bin)
        spectrum = scipy.fft.rfft(chirp, self._length)[bins]
        edge = np.minimum(np.arange(spectrum.size), np.arange(spectrum.size)[::-1]) * spacing
        taper = np.sin(np.pi / 2 * np.clip(edge / 5e3, 0, 1)) ** 2
        # Unit noise gain: white noise of unit power comes out with unit power a sample.
        weight = np.conj(spectrum) * taper
        weight *= np.sqrt(self._length / np.sum(np.abs(weight) ** 2))
        weight *= _KEPT / _OF  # fewer samples come out of the inverse transform than went in
        middle = carrier_bin - int(bins[0])
        self._weight_above = weight[middle:].astype(np.complex64)
        self._weight_below = weight[:middle].astype(np.complex64)
        ramp = np.arange(_EDGE_SAMPLES) / _EDGE_SAMPLES
        self._fade = (np.sin(np.pi / 2 * ramp) ** 2).astype(np.float32)
        # Kept from ping to ping: fresh memory costs more than the arithmetic on it.
        self._faded = np.zeros((0, self._length), np.float32)
        self._compressed = np.zeros((0, self.baseband.num_samples), np.complex64)

    def __call__(self, audio: npt.NDArray[np.float32]) -> Complex:
        """Compress ``audio``, float32 (num_mics, num_samples).

        Returns
        -------
        complex64, shape (num_mics, baseband.num_samples)
            Overwritten by the next call.
        """
        if len(self._faded) != len(audio):
            self._faded = np.zeros((len(audio), self._length), np.float32)
            self._compressed = np.zeros((len(audio), self.baseband.num_samples), np.complex64)
        faded, kept = self._faded, self._compressed
        faded[:, : self._tail] = audio[:, self._length :]
        edge = slice(self.blank - _EDGE_SAMPLES, self.blank)  # what is before it stays silent
        np.multiply(audio[:, edge], self._fade, out=faded[:, edge])
        whole = self.num_samples - self._tail
        faded[:, self.blank : whole] = audio[:, self.blank : whole]
        spectrum = scipy.fft.rfft(faded, axis=1)
        above, below = self._weight_above, self._weight_below
        np.multiply(spectrum[:, self._above], above, out=kept[:, : above.size])
        kept[:, above.size : -below.size] = 0
        np.multiply(spectrum[:, self._below], below, out=kept[:, -below.size :])
        self._compressed = scipy.fft.ifft(kept, axis=1, overwrite_x=True)
        return self._compressed


@dataclass(frozen=True, slots=True, eq=False)
class Energyscape:
    """Power over direction and range.

    power : float32, shape (num_directions, num_ranges)
        Of the beamformed, compressed echo; noise of one microphone gives 1 / 32.
    azimuth_rad, elevation_rad : shape (num_directions,)
    range_m : shape (num_ranges,)
    noise_floor : float
        Power where nothing returns.
    """

    power: npt.NDArray[np.float32]
    azimuth_rad: Float
    elevation_rad: Float
    range_m: Float
    noise_floor: float


def noise_floor(power: npt.NDArray[np.float32]) -> float:
    """A low quantile of the far ranges, the quietest of a room."""
    tail = power[::3, power.shape[1] * 6 // 10 :].ravel()
    fifth = tail.size // 5
    # Exponential law: a fifth lies under this part of the mean.
    return float(np.partition(tail, fifth)[fifth]) / 0.223 + 1e-20


class Imager:
    """Energyscape: beams toward many directions, sampled at range cells.

    Microphones are delayed by two samples each with the weights that fit the delay best over the
    chirp's band; neighbouring directions share those samples, so that a few dense products do.
    Not for use by two threads at once.

    Parameters
    ----------
    mic_positions_m : shape (num_mics, 3)
    baseband : BasebandInfo
    speed_of_sound_m_s : float
    azimuth_rad, elevation_rad : shape (num_directions,)
        Where to look; ``plane()`` looks to 91 directions at the sonar's own height.
    """

    def __init__(
        self,
        mic_positions_m: Float,
        baseband: BasebandInfo,
        speed_of_sound_m_s: float,
        azimuth_rad: Float,
        elevation_rad: Float,
    ) -> None:
        self.azimuth_rad, self.elevation_rad = azimuth_rad, elevation_rad
        toward = unit_vectors(azimuth_rad, elevation_rad)
        late_s = -toward @ mic_positions_m.T / speed_of_sound_m_s
        late = late_s * RATE_HZ
        earlier = np.floor(late).astype(int)
        margin = int(np.abs(earlier).max()) + 2
        start = int(2 * MIN_RANGE_M / speed_of_sound_m_s * RATE_HZ)
        start = max(-(-start // RANGE_STRIDE), -(-margin // RANGE_STRIDE)) * RANGE_STRIDE
        self._cells = (baseband.num_samples - margin - start) // RANGE_STRIDE - 1
        cell_s = (start + RANGE_STRIDE * np.arange(self._cells)) / RATE_HZ
        self.range_m = cell_s * speed_of_sound_m_s / 2
        self._columns = baseband.num_samples // RANGE_STRIDE
        shape = (len(mic_positions_m), RANGE_STRIDE, self._columns)
        self._phases = np.zeros(shape, np.complex64)  # kept from ping to ping
        self._windows = _windows(self._phases, self._cells)
        turn = np.exp(2j * np.pi * baseband.carrier_hz * late_s) / len(mic_positions_m)
        pair = _two_tap_weights(late - earlier, baseband.half_band_hz) * turn[:, :, None]
        self._blocks = [
            self._block(earlier[first : first + _BLOCK_DIRECTIONS] + start, pair[first:])
            for first in range(0, len(toward), _BLOCK_DIRECTIONS)
        ]

    def _block(
        self, first: npt.NDArray[np.intp], pair: npt.NDArray[np.complex128]
    ) -> tuple[Complex, npt.NDArray[np.intp]]:
        """Steering matrix (directions, rows), and where each row begins in the polyphase copy.

        ``first`` is the sample that each direction and microphone begins with, ``pair`` what that
        one and the next are multiplied by.
        """
        num_directions, num_mics = first.shape
        mic = np.broadcast_to(np.arange(num_mics), first.shape)
        both = np.stack([first, first + 1], axis=2)
        key = np.stack([mic, mic], axis=2) * (self._columns * RANGE_STRIDE) + both
        rows, column = np.unique(key.ravel(), return_inverse=True)
        steering = np.zeros((num_directions, rows.size), np.complex64)
        direction = np.repeat(np.arange(num_directions), 2 * num_mics)
        steering[direction, column] = pair[:num_directions].ravel()
        mic_of, sample = np.divmod(rows, self._columns * RANGE_STRIDE)
        phase = mic_of * RANGE_STRIDE + sample % RANGE_STRIDE
        return steering, phase * self._columns + sample // RANGE_STRIDE

    def __call__(self, baseband: Complex) -> Energyscape:
        """Image ``baseband``, complex64 (num_mics, num_samples)."""
        samples = baseband[:, : self._columns * RANGE_STRIDE]
        self._phases[...] = samples.reshape(-1, self._columns, RANGE_STRIDE).transpose(0, 2, 1)
        power = np.empty((self.azimuth_rad.size, self._cells), np.float32)
        first = 0
        for steering, offsets in self._blocks:
            delayed = self._windows[offsets].view(np.complex64).reshape(-1, self._cells)
            beams = steering @ delayed
            squares = beams.view(np.float32)
            squares *= squares
            np.add(squares[:, ::2], squares[:, 1::2], out=power[first : first + len(beams)])
            first += len(beams)
        return Energyscape(
            power, self.azimuth_rad, self.elevation_rad, self.range_m, noise_floor(power)
        )


def _two_tap_weights(part: Float, half_band_hz: float) -> Float:
    """Best weights of a sample and the next for a delay between them.

    Least squares of ``a + b e^{iw}`` against ``e^{iwp}`` over the band, w in radians a sample.

    Parameters
    ----------
    part : shape (...)
        The delay beyond the first sample, 0 to 1.
    half_band_hz : float

    Returns
    -------
    shape (..., 2)
    """
    whole = 2 * half_band_hz / RATE_HZ
    neighbour = float(np.sinc(whole))
    angle = np.empty((*part.shape, 2))
    angle[..., 0], angle[..., 1] = part, 1 - part
    angle *= np.pi * whole
    np.maximum(angle, 1e-9, out=angle)  # where the sine is as large
    # Means of e^{iw shift} over the band, for shifts to either one; a whole sample's is above.
    means = np.sin(angle) / angle
    return np.asarray((means - neighbour * means[..., ::-1]) / (1 - neighbour**2))


class Focus:
    """Beamforms the baseband on single points, spherical wavefronts and all."""

    def __init__(
        self,
        mic_positions_m: Float,
        emitter_position_m: Float,
        info: BasebandInfo,
        speed_of_sound_m_s: float,
    ) -> None:
        self.mics, self.emitter = mic_positions_m, emitter_position_m
        self.info, self.c = info, speed_of_sound_m_s
        # |p - m|^2 = |p|^2 + |m|^2 - 2 p m: one product instead of all differences.
        all_m = np.concatenate([mic_positions_m, emitter_position_m[None]])
        self._square = np.sum(all_m**2, axis=1)
        self._twice = -2 * all_m.T

    def delays_s(self, points_m: Float) -> Float:
        """Two-way travel times emitter -> point -> microphones, shape (num_points, num_mics)."""
        ways = points_m @ self._twice
        ways += self._square
        ways += (points_m**2).sum(axis=1, keepdims=True)
        np.maximum(ways, 0, out=ways)
        np.sqrt(ways, out=ways)
        return np.asarray((ways[:, :-1] + ways[:, -1:]) / self.c)

    def subbands(
        self,
        baseband: Complex,
        delays_s: Float,
        offsets_hz: npt.NDArray[np.floating],
        to_subbands: Complex,
    ) -> Complex:
        """Each microphone's sound around its own delay, by subbands, in phase with the others.

        Parameters
        ----------
        baseband : complex64, shape (num_mics, num_samples)
        delays_s : shape (num_points, num_mics)
        offsets_hz : shape (num_subbands,)
            Of the subbands, from the carrier.
        to_subbands : complex64, shape (length, num_subbands)
            What takes a window to them. Sample ``length // 2`` of the window is nearest to the
            delay; silence beyond the frame.

        Returns
        -------
        complex64, shape (num_points, num_mics, num_subbands)
        """
        length = len(to_subbands)
        nearest = np.rint(delays_s * RATE_HZ)
        pieces = _pieces(baseband, nearest.astype(np.intp) - length // 2, length)
        cycles = (delays_s - nearest / RATE_HZ)[:, :, None] * offsets_hz
        cycles += (self.info.carrier_hz * delays_s)[:, :, None]
        heard = pieces.reshape(-1, length) @ to_subbands
        return np.asarray(heard.reshape(cycles.shape) * phasor(cycles))

    def beam(self, baseband: Complex, points_m: Float, before: int, length: int) -> Complex:
        """The sound from each point, shape (num_points, length), at the baseband's rate.

        Sample ``before`` is the point's own two-way time. Silence beyond the frame.
        """
        delays_s = self.delays_s(points_m)
        late = delays_s * RATE_HZ
        earlier = np.floor(late)
        pieces = _pieces(baseband, earlier.astype(np.intp) - before, length + 1)
        pair = _two_tap_weights(late - earlier, self.info.half_band_hz)
        turn = phasor(self.info.carrier_hz * delays_s) / np.float32(len(self.mics))
        pair = pair.astype(np.float32) * turn[:, :, None]
        both = pair.transpose(0, 2, 1) @ pieces
        return np.asarray(both[:, 0, :-1] + both[:, 1, 1:])


def _windows(samples: Complex, length: int) -> npt.NDArray[np.void]:
    """All runs of ``length`` samples, each as one item: taking some of them is a copy each.

    Of a contiguous array of any shape, as if it were of one dimension; a view of its memory.
    """
    flat = samples.reshape(-1)
    window = np.dtype((np.void, length * flat.itemsize))
    windows = np.ndarray(flat.size - length + 1, window, flat, 0, flat.strides)
    return np.asarray(windows)


def _pieces(baseband: Complex, first: npt.NDArray[np.intp], length: int) -> Complex:
    """Copies of each microphone's samples from ``first``, shape (num_points, num_mics), on."""
    num_mics, num_samples = baseband.shape
    if first.min() >= 0 and first.max() <= num_samples - length:
        windows = _windows(np.ascontiguousarray(baseband), length)
        chosen = windows[first + num_samples * np.arange(num_mics)]
        return np.asarray(chosen.view(np.complex64).reshape(*first.shape, length))
    index = first[:, :, None] + np.arange(length)
    valid = (index >= 0) & (index < num_samples)
    inside = np.clip(index, 0, num_samples - 1)
    return np.asarray(baseband[np.arange(num_mics)[:, None], inside] * valid)
