"""Make the table of dish strengths: ``python -m ertis_simulator.dish_fit``.

Scattering is computed for pairs of directions around each tilt, exactly by boundary elements for
the landmark's depth and by iterated physical optics for bowls; the strengths of the glints are
fitted to it, least squares over frequency and pairs at once: their ways and Bessel functions tell
them apart. One core, 12 minutes of it.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import jv

from ertis_simulator.circles import RIM
from ertis_simulator.dish_table import LOWEST_KA, NUM_POWERS, TILTS_RAD, powers
from ertis_simulator.glints import FOCUSED, ORDERS, TERMS, glints
from ertis_simulator.physical_optics import CapOptics
from ertis_simulator.reference.meridian import CapMeridian
from ertis_simulator.reference.screen import Screen
from ertis_simulator.rim import rim_orders

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

log = logging.getLogger(__name__)

_Scatter = Callable[[FloatArray, FloatArray, FloatArray], ComplexArray]  # tilts, azimuth between

_FAR = 1e5  # aperture radii: wavefronts there are flat over a dish
_HEADING_RAD = np.deg2rad([0.0, 30.0, 60.0, 90.0])
_WIDEST_RAD = 0.6
_RIDGE = 3e-3  # against strengths that cancel each other


class Plan(NamedTuple):
    """Where one depth is sampled: how many ka, up to which, ka times the directions' gap; how."""

    num_ka: int
    highest_ka: float
    gaps_ka: tuple[float, ...]
    is_exact: bool = False


# The landmark's own depth densely; bowls need to sound like bowls, no more.
LANDMARK_PLAN = Plan(52, 150.0, (1.5, 3.0, 5.0, 8.0, 12.0), is_exact=True)
BOWL_PLAN = Plan(24, 80.0, (2.0, 5.0, 9.0))
PLANS = {
    0.2: BOWL_PLAN,
    0.4: BOWL_PLAN,
    0.6: LANDMARK_PLAN,
    0.8: BOWL_PLAN,
    1.0: BOWL_PLAN,
}


def frequencies_ka(plan: Plan) -> FloatArray:
    """Unevenly spaced, so that no two ways look alike."""
    step = np.arange(plan.num_ka)
    jitter = (step * 0.618) % 1 * 0.9
    return LOWEST_KA + (plan.highest_ka - LOWEST_KA) * (step + jitter) / plan.num_ka


def pairs(tilt_rad: float, ka: float, plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Directions there and back with one bisector, each of shape (num_pairs, 3)."""
    tilt_rad = max(tilt_rad, 1e-3)  # the azimuth around the bisector needs a plane to start from
    gap = np.minimum(np.repeat(plan.gaps_ka, len(_HEADING_RAD)) / ka, _WIDEST_RAD)
    gap = np.concatenate([[0.0], gap])[:, None]
    heading = np.concatenate([[0.0], np.tile(_HEADING_RAD, len(plan.gaps_ka))])[:, None]
    sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
    bisector = np.array([sine, 0.0, cosine])
    half = np.cos(heading) * np.array([cosine, 0.0, -sine]) + np.sin(heading) * np.eye(3)[1]
    middle = np.sqrt(1 - (gap / 2) ** 2) * bisector
    return middle + half * gap / 2, middle - half * gap / 2


def sample(depth_ratio: float, plan: Plan) -> ComplexArray:
    """Scattering lengths over aperture radius, shape (num_ka, num_tilts, num_pairs)."""
    found = []
    for ka in frequencies_ka(plan):
        directions = [pairs(tilt, ka, plan) for tilt in TILTS_RAD]
        cap = CapOptics(depth_ratio, ka)
        scatter: _Scatter = cap.far_field
        if plan.is_exact:
            scatter = Screen.build(CapMeridian(cap.radius, cap.half_opening), ka).amplitude
        found.append([_scattered(scatter, there, back) for there, back in directions])
        log.info("depth ratio %s: ka %.1f of %.0f", depth_ratio, ka, plan.highest_ka)
    return np.array(found)


def _scattered(
    scatter: _Scatter,
    there: FloatArray,
    back: FloatArray,
) -> ComplexArray:
    apart = np.arctan2(there[:, 1], there[:, 0]) - np.arctan2(back[:, 1], back[:, 0])
    return scatter(np.arccos(there[:, 2]), np.arccos(back[:, 2]), apart)


def unit_terms(
    depth_ratio: float, ka: float, there: FloatArray, back: FloatArray
) -> npt.NDArray[np.complex128]:
    """Every glint at strength 1, far away: shape (num_pairs, num_terms)."""
    laid = glints(1.0, depth_ratio, np.eye(3)[2], _FAR * there, _FAR * back)
    columns = []
    for (circle, order), focused in zip(TERMS, FOCUSED, strict=True):
        turn = (-1j) ** order if circle == RIM else np.cos(order * laid.around_rad[circle])
        bessel = jv(order, ka * laid.reach_m[circle])
        wave = np.exp(1j * ka * laid.path_m[circle]) * (np.sqrt(ka) if focused else 1.0)
        columns.append(turn * bessel * wave)
    return np.stack(columns, axis=1)


def fit_tilt(depth_ratio: float, plan: Plan, tilt_rad: float, found: ComplexArray) -> ComplexArray:
    """Strengths at one tilt from samples of shape (num_ka, num_pairs)."""
    ka_of = frequencies_ka(plan)
    basis = powers(ka_of, plan.highest_ka)
    rows, wanted = [], []
    for ka, each, values in zip(ka_of, basis, found, strict=True):
        terms = unit_terms(depth_ratio, ka, *pairs(tilt_rad, ka, plan))
        # Every frequency counts alike, however loud.
        level = np.sqrt(np.mean(np.abs(values) ** 2)) + 1e-2
        rows.append((terms[:, :, None] * each).reshape(len(terms), -1) / level)
        wanted.append(values / level)
    matrix, values = np.concatenate(rows), np.concatenate(wanted)
    square = matrix.conj().T @ matrix
    ridge = _RIDGE**2 * len(values) * np.eye(len(square))
    solved = np.linalg.solve(square + ridge, matrix.conj().T @ values)
    return np.asarray(solved.reshape(len(TERMS), NUM_POWERS))


def fit(depth_ratio: float, plan: Plan, samples: ComplexArray) -> ComplexArray:
    """Strengths at all tilts with a sharp rim, shape (num_tilts, num_terms, NUM_POWERS)."""
    fitted = np.array(
        [
            fit_tilt(depth_ratio, plan, tilt, samples[:, number])
            for number, tilt in enumerate(TILTS_RAD)
        ]
    )
    if plan.is_exact:
        return fitted
    half_opening_rad = CapOptics(depth_ratio, 1.0).half_opening
    rim_terms = [TERMS.index((RIM, order)) for order in ORDERS[RIM]]
    # The first polynomial is 1, and an edge's diffraction does not depend on frequency.
    fitted[:, rim_terms, 0] += rim_orders(half_opening_rad, TILTS_RAD)
    return fitted


def write_table(path: Path, coefficients: dict[float, ComplexArray]) -> None:
    """Write fitted strengths, by depth ratio, as :mod:`ertis_simulator.dish_table` reads them."""
    ratios = sorted(coefficients)
    np.savez_compressed(
        path,
        depth_ratio=np.array(ratios),
        coefficients=np.array([coefficients[ratio] for ratio in ratios], np.complex64),
        highest_ka=np.array([PLANS[ratio].highest_ka for ratio in ratios]),
    )


def main() -> None:
    """Compute everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).parent / "data/dish_table.npz"
    parser.add_argument("--out", type=Path, default=default, help="default: the shipped table")
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    fitted = {ratio: fit(ratio, plan, sample(ratio, plan)) for ratio, plan in PLANS.items()}
    write_table(args.out, fitted)


if __name__ == "__main__":
    main()
