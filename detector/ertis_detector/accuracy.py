"""Where located landmarks were said to be: errors, and whether their covariance is true."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from ertis_detector.detection import Detection
from ertis_detector.intervals import COVERAGE, NO_INTERVAL, Interval
from ertis_detector.matching import TrueLandmark

Float = npt.NDArray[np.float64]

AXES = ("range_m", "azimuth_rad", "elevation_rad")


@dataclass(frozen=True, slots=True, eq=False)
class PlaceErrors:
    """Told less true, of ``count`` located landmarks.

    errors : shape (count, 3)
        Range (m), azimuth and elevation (rad); NaN where nobody knows.
    sizes : label of each
    bias, rms : three values
    sigmas : three values
        What the reported variances promise, as the root of their mean.
    range_bias_by_size_m : label -> mean error of the reports with that size
    range_sigma_m : float
        Standard deviation once those are taken out.
    nees : float
        Mean normalised estimation error squared, over as many dimensions as ``nees_dimensions``;
        a true covariance gives that number (Bar-Shalom, Li and Kirubarajan 2001, 5.4).
    nees_band : (low, high)
        Where 95 % of such means lie if the covariance is true and errors are independent.
    nees_by_axis : of each axis alone; a true variance gives 1
    tilt_rmse_rad : float
        Of the reports that tell a tilt, whatever their size.
    tilts : int
    """

    count: int
    errors: Float
    sizes: tuple[str, ...]
    bias: tuple[float, ...]
    rms: tuple[float, ...]
    sigmas: tuple[float, ...]
    range_bias_by_size_m: dict[str, float]
    range_sigma_m: float
    nees: float
    nees_dimensions: int
    nees_band: Interval
    nees_by_axis: tuple[float, ...]
    tilt_rmse_rad: float
    tilts: int


def place_errors(pairs: Sequence[tuple[TrueLandmark, Detection]]) -> PlaceErrors:
    """Errors of located landmarks.

    Parameters
    ----------
    pairs
        True landmark and its report, whether or not the size is right.
    """
    errors = np.array(
        [[getattr(told, axis) - getattr(true, axis) for axis in AXES] for true, told in pairs]
    ).reshape(-1, 3)
    covariances = np.array([told.covariance for _, told in pairs], float).reshape(-1, 3, 3)
    sizes = tuple(told.label for _, told in pairs)
    by_size = {
        name: float(errors[[one == name for one in sizes], 0].mean()) for name in sorted(set(sizes))
    }
    without_bias = errors[:, 0] - np.array([by_size[name] for name in sizes])
    known = ~np.isnan(errors).all(axis=0) if len(pairs) else np.zeros(3, bool)
    squares = _normalised(errors[:, known], covariances[:, known][:, :, known])
    squares = squares[~np.isnan(squares)]
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    by_axis = errors**2 / variances
    tilts = np.array([told.tilt_rad - true.tilt_rad for true, told in pairs])
    tilts = tilts[~np.isnan(tilts)]
    dimensions = int(known.sum())
    return PlaceErrors(
        count=len(pairs),
        errors=errors,
        sizes=sizes,
        bias=tuple(_mean(column) for column in errors.T),
        rms=tuple(float(np.sqrt(_mean(column**2))) for column in errors.T),
        sigmas=tuple(float(np.sqrt(_mean(column))) for column in variances.T),
        range_bias_by_size_m=by_size,
        range_sigma_m=(
            float(np.sqrt(np.sum(without_bias**2) / (len(pairs) - len(by_size))))
            if len(pairs) > len(by_size)
            else float("nan")
        ),
        nees=_mean(squares),
        nees_dimensions=dimensions,
        nees_band=nees_band(squares.size, dimensions),
        nees_by_axis=tuple(_mean(column) for column in by_axis.T),
        tilt_rmse_rad=float(np.sqrt(_mean(tilts**2))),
        tilts=tilts.size,
    )


def nees_band(count: int, dimensions: int) -> Interval:
    """Where a mean NEES lies if all is true: chi-square of ``count * dimensions`` over ``count``.

    >>> low, high = nees_band(100, 3)
    >>> round(low, 2), round(high, 2)
    (2.54, 3.5)
    """
    if count == 0 or dimensions == 0:
        return NO_INTERVAL
    tail = (1 - COVERAGE) / 2
    law = stats.chi2(count * dimensions)
    return float(law.ppf(tail)) / count, float(law.ppf(1 - tail)) / count


def _normalised(errors: Float, covariances: Float) -> Float:
    """E' C^-1 e of each row."""
    if errors.size == 0:
        return np.empty(0)
    solved = np.linalg.solve(covariances, errors[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ij,ij->i", errors, solved))


def _mean(values: Float) -> float:
    kept = values[~np.isnan(values)]
    return float(kept.mean()) if kept.size else float("nan")
