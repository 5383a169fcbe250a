"""Where exactly proposals lie: azimuth, elevation and range by beams around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.fragment import hann
from ertis_detector.imaging import RATE_HZ, Complex, Float, Focus, unit_vectors
from ertis_detector.proposals import Proposal

_WINDOW = 64  # audio samples: 142 us, the rings of one dish; 7 kHz a subband
_HALF_PEAK = 20  # audio samples searched for the peak on either side: +-15 mm
_ELEVATIONS_RAD = np.deg2rad(np.arange(-48.0, 49.0, 8.0))
_STEPS_RAD = np.deg2rad(((2.0, 4.0), (1.0, 2.0), (0.5, 1.0)))
_MAX_ELEVATION_RAD = np.deg2rad(60.0)


@dataclass(frozen=True, slots=True)
class Location:
    """A point that returns sound; power is of the beam, as in the energyscape."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float
    power: float

    @property
    def point_m(self) -> Float:
        """Shape (3,), sensor frame."""
        direction = unit_vectors(np.array(self.azimuth_rad), np.array(self.elevation_rad))
        return np.asarray(self.range_m * direction)


def locate(focus: Focus, baseband: Complex, proposals: Sequence[Proposal]) -> list[Location]:
    """Refine proposals: elevation first, then both angles, then the range.

    Parameters
    ----------
    focus : Focus
    baseband : complex64, shape (num_mics, num_samples)
    proposals : of this ping
    """
    if not proposals:
        return []
    range_m = np.array([one.range_m for one in proposals])
    azimuth = np.array([one.azimuth_rad for one in proposals])
    elevation = np.zeros_like(azimuth)
    steerer = _Steerer(focus, baseband, range_m, azimuth)
    energy = steerer.energy(azimuth[:, None], _ELEVATIONS_RAD[None, :])
    elevation = _ELEVATIONS_RAD[energy.argmax(axis=1)]
    grid_a, grid_e = (grid.ravel() for grid in np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"))
    for step_a, step_e in _STEPS_RAD:
        energy = steerer.energy(
            azimuth[:, None] + step_a * grid_a, elevation[:, None] + step_e * grid_e
        ).reshape(-1, 3, 3)
        azimuth = azimuth + step_a * _tops(energy.max(axis=2))
        elevation = elevation + step_e * _tops(energy.max(axis=1))
        elevation = np.clip(elevation, -_MAX_ELEVATION_RAD, _MAX_ELEVATION_RAD)
    points = range_m[:, None] * unit_vectors(azimuth, elevation)
    beam = np.abs(focus.beam(baseband, points, _HALF_PEAK, 2 * _HALF_PEAK + 1)) ** 2
    peak = beam[:, 1:-1].argmax(axis=1) + 1
    row = np.arange(len(peak))
    three = np.stack([beam[row, peak - 1], beam[row, peak], beam[row, peak + 1]], axis=1)
    offset = peak + _tops(three) - _HALF_PEAK
    range_m = range_m + offset / RATE_HZ * focus.c / 2
    return [
        Location(float(r), float(a), float(e), float(p))
        for r, a, e, p in zip(range_m, azimuth, elevation, beam[row, peak], strict=True)
    ]


class _Steerer:
    """Energy of short windows around proposals, seen from directions near them, by subbands."""

    def __init__(self, focus: Focus, baseband: Complex, range_m: Float, azimuth: Float) -> None:
        self._focus, self._range = focus, range_m
        points = range_m[:, None] * unit_vectors(azimuth, np.zeros_like(azimuth))
        self._delays = focus.delays_s(points)
        pieces, residue = focus.windows(baseband, self._delays, _WINDOW // 2, _WINDOW)
        spectrum = scipy.fft.fft(pieces * hann(_WINDOW), axis=2)
        # Beyond +-28 kHz of the carrier no chirp of this sensor has energy.
        bins = np.arange(-4, 5)
        self._spacing_hz = RATE_HZ / _WINDOW
        shift = np.exp(2j * np.pi * self._spacing_hz * residue[:, :, None] * bins)
        self._spectrum = (spectrum[:, :, bins] * shift).astype(np.complex64)
        self._first_bin = int(bins[0])

    def energy(self, azimuth: Float, elevation: Float) -> Float:
        """Shape (num_proposals, num_directions), from angles of that shape."""
        toward = self._range[:, None, None] * unit_vectors(azimuth, elevation)
        count, directions, _ = toward.shape
        later = self._focus.delays_s(toward.reshape(-1, 3)).reshape(count, directions, -1)
        later -= self._delays[:, None, :]
        # Powers of one phasor, bin by bin, instead of an exponential for each.
        first_hz = self._focus.carrier_hz + self._first_bin * self._spacing_hz
        phasor = np.exp(2j * np.pi * first_hz * later).astype(np.complex64)
        turn = np.exp(2j * np.pi * self._spacing_hz * later).astype(np.complex64)
        energy = np.zeros((count, directions), np.float64)
        for column in range(self._spectrum.shape[2]):
            beam = (phasor @ self._spectrum[:, :, column, None])[:, :, 0]
            energy += beam.real**2 + beam.imag**2
            phasor *= turn
        return energy


def _tops(three: npt.NDArray[np.floating]) -> Float:
    """Offsets of parabolas' tops from the middle of three values, in steps; shape (n, 3) in."""
    a, b, c = three[:, 0], three[:, 1], three[:, 2]
    bend = a - 2 * b + c
    safe = np.where(bend < 0, bend, -1.0)
    top = np.clip((a - c) / (2 * safe), -1.0, 1.0)
    return np.asarray(np.where(bend < 0, top, np.where(c > a, 1.0, -1.0)), np.float64)
