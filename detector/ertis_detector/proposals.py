"""Proposals: the distinct peaks of an energyscape, not their sidelobes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.imaging import Energyscape, Float, unit_vectors

# What a peak hides, as (range cells on either side, part of its power): its main lobe and the
# dish's own ring pattern; the array's sidelobes at its range; the chirp's range sidelobes.
_MAIN_LOBE_CELLS, _MAIN_LOBE_SINE = 13, (0.16, 0.3)
_ARRAY_SIDELOBES = (13, 10 ** (-7.5 / 10))
_CHIRP_SIDELOBES = (66, 10 ** (-23 / 10))


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
    azimuth_rad, power = scape.azimuth_rad, scape.power
    floor = scape.noise_floor
    weight = (scape.range_m**range_exponent).astype(np.float32)
    if within_m is not None:
        weight[(scape.range_m < within_m[0]) | (scape.range_m > within_m[1])] = 0
    least = np.full(power.shape[1], floor * 10 ** (np.asarray(min_snr_db) / 10), np.float32)
    ranked = power * weight
    ranked *= power >= least
    toward = unit_vectors(azimuth_rad, scape.elevation_rad)
    found: list[Proposal] = []
    while len(found) < max_count:
        direction, cell = np.unravel_index(int(ranked.argmax()), ranked.shape)
        if ranked[direction, cell] <= 0:
            break
        peak = float(power[direction, cell])
        found.append(
            Proposal(
                float(scape.range_m[cell]),
                float(azimuth_rad[direction]),
                float(10 * np.log10(peak / floor)),
            )
        )
        away = np.abs(toward - toward[direction])
        main_lobe = (away[:, 1] < _MAIN_LOBE_SINE[0]) & (away[:, 2] < _MAIN_LOBE_SINE[1])
        _hide(ranked, power, peak, int(cell), main_lobe)
    return found


def _hide(
    ranked: npt.NDArray[np.float32],
    power: npt.NDArray[np.float32],
    peak: float,
    cell: int,
    main_lobe: npt.NDArray[np.bool_],
) -> None:
    near = slice(max(cell - _MAIN_LOBE_CELLS, 0), cell + _MAIN_LOBE_CELLS + 1)
    ranked[main_lobe, near] = 0
    for cells, part in (_ARRAY_SIDELOBES, _CHIRP_SIDELOBES):
        around = slice(max(cell - cells, 0), cell + cells + 1)
        ranked[:, around] *= power[:, around] >= peak * part
