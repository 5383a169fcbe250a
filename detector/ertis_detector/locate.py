"""Where exactly proposals lie: azimuth, elevation and range by beams around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.fragment import hann
from ertis_detector.imaging import RATE_HZ, Complex, Float, Focus, phasor, unit_vectors
from ertis_detector.proposals import Proposal

_WINDOW = 24  # baseband samples: 142 us, the rings of one dish; 7 kHz a subband
_HALF_PEAK = 8  # baseband samples searched for the peak on either side: +-15 mm
_ELEVATION_STEP_RAD = np.deg2rad(8.0)
_ELEVATIONS_RAD = _ELEVATION_STEP_RAD * np.arange(-6, 7)
_STEPS_RAD = np.deg2rad(
    ((2.0, 4.0), (0.7, 1.4))
)  # a third moves 19 in 20 by less than 0.07 degrees
_MAX_ELEVATION_RAD = np.deg2rad(60.0)
_GRID_A, _GRID_E = np.repeat([-1, 0, 1], 3), np.tile([-1, 0, 1], 3)
# Beyond +-28 kHz of the carrier no chirp of this sensor has energy; between lie no new facts.
_SUBBANDS = np.arange(-4, 5, 2)
_TO_SUBBANDS = phasor(np.outer(np.arange(_WINDOW), -_SUBBANDS / _WINDOW)) * hann(_WINDOW)[:, None]
_LEAST_BEND = 1e-20  # of power; what is heard bends by 1e-10 or more


@dataclass(frozen=True, slots=True)
class Location:
    """A point that returns sound; power is of the beam, as in the energyscape."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float
    power: float


def locate(
    focus: Focus,
    baseband: Complex,
    proposals: Sequence[Proposal],
    max_elevation_rad: float = _MAX_ELEVATION_RAD,
) -> list[Location]:
    """Refine proposals: elevation first, then both angles, then the range.

    Parameters
    ----------
    focus : Focus
    baseband : complex64, shape (num_mics, num_samples)
    proposals : of this ping
    max_elevation_rad : float
        What lies further above or below is not refined, and left out.
    """
    range_m = np.array([one.range_m for one in proposals])
    azimuth = np.array([one.azimuth_rad for one in proposals])
    if not proposals:
        return []
    steerer = _Steerer(focus, baseband, range_m, azimuth)
    energy = steerer.energy(azimuth[:, None], _ELEVATIONS_RAD[None, :])
    elevation = _ELEVATIONS_RAD[energy.argmax(axis=1)]
    kept = np.abs(elevation) <= max_elevation_rad + _ELEVATION_STEP_RAD
    if not kept.any():
        return []
    range_m, azimuth, elevation = range_m[kept], azimuth[kept], elevation[kept]
    steerer.keep(kept)
    for step_a, step_e in _STEPS_RAD:
        energy = steerer.energy(
            azimuth[:, None] + step_a * _GRID_A, elevation[:, None] + step_e * _GRID_E
        ).reshape(-1, 3, 3)
        azimuth = azimuth + step_a * _tops(energy.max(axis=2))
        elevation = elevation + step_e * _tops(energy.max(axis=1))
        elevation = np.clip(elevation, -_MAX_ELEVATION_RAD, _MAX_ELEVATION_RAD)
    points = range_m[:, None] * unit_vectors(azimuth, elevation)
    beam = np.abs(focus.beam(baseband, points, _HALF_PEAK, 2 * _HALF_PEAK + 1)) ** 2
    peak = beam[:, 1:-1].argmax(axis=1) + 1
    three = np.take_along_axis(beam, peak[:, None] + np.arange(-1, 2), 1)
    offset = peak + _tops(three) - _HALF_PEAK
    range_m = range_m + offset / RATE_HZ * focus.c / 2
    return [
        Location(float(r), float(a), float(e), float(p))
        for r, a, e, p in zip(range_m, azimuth, elevation, three[:, 1], strict=True)
        if abs(e) <= max_elevation_rad
    ]


class _Steerer:
    """Energy of short windows around proposals, seen from directions near them, by subbands."""

    def __init__(self, focus: Focus, baseband: Complex, range_m: Float, azimuth: Float) -> None:
        self._focus, self._range = focus, range_m
        points = range_m[:, None] * unit_vectors(azimuth, np.zeros_like(azimuth))
        self._delays = focus.delays_s(points)
        offsets_hz = RATE_HZ / _WINDOW * _SUBBANDS
        heard = focus.subbands(baseband, self._delays, offsets_hz, _TO_SUBBANDS)
        self._heard = heard.transpose(0, 2, 1)[:, :, :, None].copy()  # subband by subband
        self._subbands_hz = (focus.info.carrier_hz + offsets_hz).astype(np.float32)[:, None, None]

    def keep(self, which: npt.NDArray[np.bool_]) -> None:
        """Go on with these proposals only; bool, shape (num_proposals,)."""
        self._range, self._delays = self._range[which], self._delays[which]
        self._heard = self._heard[which]

    def energy(self, azimuth: Float, elevation: Float) -> Float:
        """Shape (num_proposals, num_directions), from angles of that shape."""
        toward = self._range[:, None, None] * unit_vectors(azimuth, elevation)
        count, directions, _ = toward.shape
        later = self._focus.delays_s(toward.reshape(-1, 3)).reshape(count, directions, -1)
        later -= self._delays[:, None, :]
        turned = phasor(later.astype(np.float32)[:, None] * self._subbands_hz)
        parts = (turned @ self._heard).view(np.float32)
        return np.asarray(np.einsum("psdi,psdi->pd", parts, parts), np.float64)


def _tops(three: npt.NDArray[np.floating]) -> Float:
    """Offsets of parabolas' tops from the middle of three values, in steps; shape (n, 3) in."""
    a, b, c = three[:, 0], three[:, 1], three[:, 2]
    # One that does not bend down has its top at the greater end.
    bend = np.minimum(a - 2 * b + c, -_LEAST_BEND)
    top = np.maximum(np.minimum((a - c) / (2 * bend), 1.0), -1.0)
    return np.asarray(top, np.float64)
