"""Proposals: the distinct peaks of an energyscape, not their sidelobes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ertis_detector.imaging import Energyscape, Float, unit_vectors

# What a peak hides, as (range cells on either side, part of its power): its main lobe and the
# dish's own ring pattern; the array's sidelobes at its range; the chirp's range sidelobes.
_MAIN_LOBE_CELLS, _MAIN_LOBE_SINE = 13, (0.16, 0.3)
_ARRAY_SIDELOBES = (13, 10 ** (-7.5 / 10))
_CHIRP_SIDELOBES = (66, 10 ** (-23 / 10))
_SIDELOBES = np.full(_CHIRP_SIDELOBES[0] + 1, _CHIRP_SIDELOBES[1])  # by range cells away
_SIDELOBES[: _ARRAY_SIDELOBES[0] + 1] = _ARRAY_SIDELOBES[1]


@dataclass(frozen=True, slots=True)
class Proposal:
    """A peak: where, and how far over the noise floor."""

    range_m: float
    azimuth_rad: float
    snr_db: float


def propose(
    scape: Energyscape,
    *,
    max_count: int,
    min_snr_db: float | Float,
    range_exponent: float = 2.0,
    within_m: tuple[float, float] | None = None,
) -> list[Proposal]:
    """The peaks worth a closer look, most promising first.

    Parameters
    ----------
    scape : Energyscape
    max_count : int
    min_snr_db : float, or shape (num_ranges,)
        Over the noise floor.
    range_exponent : float
        Ranked by power times this power of range: 2 keeps near clutter from crowding out a far
        landmark, 0 is plain strength.
    within_m : (nearest, furthest) or None
        Ranges looked at; None for all.
    """
    peaks = _StrongCells(scape, min_snr_db, range_exponent, within_m)
    found: list[Proposal] = []
    while len(found) < max_count and (peak := peaks.take_highest()) is not None:
        found.append(peak)
    return found


class _StrongCells:
    """The cells of an energyscape that are strong enough, by range: few, and a peak's together."""

    def __init__(
        self,
        scape: Energyscape,
        min_snr_db: float | Float,
        range_exponent: float,
        within_m: tuple[float, float] | None,
    ) -> None:
        range_m = scape.range_m
        least = np.full(range_m.size, scape.noise_floor * 10 ** (np.asarray(min_snr_db) / 10))
        if within_m is not None:
            least[(range_m < within_m[0]) | (range_m > within_m[1])] = np.inf
        strong = np.flatnonzero(scape.power >= least.astype(np.float32))
        direction = strong // range_m.size
        cell = strong - direction * range_m.size
        # Numbers of 16 bits are sorted four times as fast.
        by_range = cell.astype(np.min_scalar_type(range_m.size)).argsort(kind="stable")
        self._scape = scape
        self._direction, self._cell = direction[by_range], cell[by_range]
        self._power = scape.power.ravel()[strong[by_range]]
        self._ranked = self._power * (range_m**range_exponent).astype(np.float32)[self._cell]
        self._toward = unit_vectors(scape.azimuth_rad, scape.elevation_rad)

    def take_highest(self) -> Proposal | None:
        """The most promising one, which hides what may be its own; None if none is left."""
        if not self._ranked.size:
            return None
        at = int(self._ranked.argmax())
        if not self._ranked[at]:
            return None
        direction, cell, peak = self._direction[at], self._cell[at], float(self._power[at])
        reach = _CHIRP_SIDELOBES[0]
        near = slice(*self._cell.searchsorted((cell - reach, cell + reach + 1)))
        away = np.abs(self._toward - self._toward[direction])
        main_lobe = (away[:, 1] < _MAIN_LOBE_SINE[0]) & (away[:, 2] < _MAIN_LOBE_SINE[1])
        cells_away = np.abs(self._cell[near] - cell)
        hidden = (cells_away <= _MAIN_LOBE_CELLS) & main_lobe[self._direction[near]]
        hidden |= self._power[near] < peak * _SIDELOBES[cells_away]
        self._ranked[near][hidden] = 0
        return Proposal(
            float(self._scape.range_m[cell]),
            float(self._scape.azimuth_rad[direction]),
            float(10 * np.log10(peak / self._scape.noise_floor)),
        )
