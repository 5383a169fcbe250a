"""How strong each glint of a dish is, over frequency, tilt and depth: a small table.

``data/dish_table.npz`` is made again by ``python -m ertis_simulator.dish_fit`` (see there). Each
entry is a polynomial in log(ka), as strengths vary slowly once ways and Bessel functions, which
are formulas, are taken out.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

NUM_POWERS = 7
TILTS_RAD = np.deg2rad(np.arange(0.0, 90.1, 2.5))
LOWEST_KA = 4.0
_SPAN_KA = (3.5, 155.0)


class Strengths(NamedTuple):
    """Of one depth.

    coefficients : complex64, shape (num_tilts, num_terms, NUM_POWERS)
        Over ``TILTS_RAD`` and :data:`ertis_simulator.glints.TERMS`.
    highest_ka : float
        Beyond it they are held.
    """

    coefficients: npt.NDArray[np.complex64]
    highest_ka: float


def scaled_log(ka: FloatArray, highest_ka: float) -> FloatArray:
    """What the strengths are polynomials of, -1 to 1, the same shape."""
    low, high = np.log(_SPAN_KA)
    log_ka = np.log(np.clip(ka, LOWEST_KA, highest_ka))
    return np.asarray((2 * log_ka - low - high) / (high - low))


def powers(ka: FloatArray, highest_ka: float) -> FloatArray:
    """Chebyshev polynomials in log(ka), shape (num_ka, NUM_POWERS)."""
    return np.asarray(
        np.polynomial.chebyshev.chebvander(scaled_log(ka, highest_ka), NUM_POWERS - 1)
    )


@cache
def strengths(depth_ratio: float) -> Strengths:
    """Strengths at a depth over aperture radius, between the two nearest in the table.

    Shallower or deeper than any in the table takes the nearest.
    """
    with (resources.files("ertis_simulator") / "data/dish_table.npz").open("rb") as file:
        table = np.load(file)
        ratios, coefficients, limits = (
            table[name] for name in ("depth_ratio", "coefficients", "highest_ka")
        )
    place = float(np.interp(depth_ratio, ratios, np.arange(len(ratios))))
    lower = int(place)
    upper = min(lower + (place > lower + 1e-9), len(ratios) - 1)
    share = np.float32(place - lower)
    mixed = (1 - share) * coefficients[lower] + share * coefficients[upper]
    return Strengths(mixed, float(min(limits[lower], limits[upper])))


def between_tilts(
    table: Strengths, tilt_rad: FloatArray
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32], npt.NDArray[np.complex64]]:
    """Where tilts lie in the table.

    Returns
    -------
    rows : int64, shape (num_mics,)
        Of the coefficients returned, the tilt below.
    share : float32, shape (num_mics,)
        Of the row after it.
    coefficients : complex64, shape (num_rows, num_terms, NUM_POWERS)
        The part of the table that these tilts need.
    """
    place = np.clip(tilt_rad / TILTS_RAD[1], 0, len(TILTS_RAD) - 1)
    lower = np.minimum(place.astype(np.int64), len(TILTS_RAD) - 2)
    first = int(lower.min())
    part = table.coefficients[first : int(lower.max()) + 2]
    return lower - first, (place - lower).astype(np.float32), part
