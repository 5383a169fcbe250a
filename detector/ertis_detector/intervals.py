"""How sure a rate is: intervals of counts, and of means over pings that are not independent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import stats

COVERAGE = 0.95
RESAMPLES = 4000  # ends of the interval are then steady to a tenth of its width

Interval = tuple[float, float]
NO_INTERVAL: Interval = (float("nan"), float("nan"))


def wilson(successes: int, trials: int, coverage: float = COVERAGE) -> Interval:
    """Interval of a share, from independent trials (Wilson 1927, score interval).

    (nan, nan) without trials.

    >>> low, high = wilson(0, 10)
    >>> low, round(high, 3)
    (0.0, 0.278)
    """
    if trials == 0:
        return NO_INTERVAL
    z = float(stats.norm.ppf(0.5 + coverage / 2))
    share = successes / trials
    middle = share + z * z / (2 * trials)
    half = z * np.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    low, high = (middle - half) / scale, (middle + half) / scale
    # Rounding must not cut off what was seen.
    return max(0.0, min(float(low), share)), min(1.0, max(float(high), share))


def garwood(events: int, exposure: float, coverage: float = COVERAGE) -> Interval:
    """Interval of a rate, from events counted over an exposure (Garwood 1936, exact Poisson).

    (nan, nan) without exposure.

    >>> low, high = garwood(0, 2.0)
    >>> low, round(high, 3)
    (0.0, 1.844)
    """
    if exposure <= 0:
        return NO_INTERVAL
    tail = (1 - coverage) / 2
    low = float(stats.chi2.ppf(tail, 2 * events)) / 2 if events else 0.0
    high = float(stats.chi2.ppf(1 - tail, 2 * events + 2)) / 2
    return low / exposure, high / exposure


def cluster_bootstrap(
    values: npt.ArrayLike,
    clusters: Sequence[str],
    *,
    seed: int = 0,
    coverage: float = COVERAGE,
) -> Interval:
    """Interval of a mean over items that come in clusters: whole clusters are drawn again.

    Pings of one session share room, sonar pose and clutter; drawn one by one they would claim more
    than they know. Percentile interval (Efron and Tibshirani 1993, chapter 13).

    Parameters
    ----------
    values : float, shape (n,)
        NaN is left out.
    clusters : n names

    Returns
    -------
    (low, high)
        (nan, nan) with fewer than two clusters that hold a value.
    """
    array = np.asarray(values, np.float64)
    counted = ~np.isnan(array)
    names, index = np.unique(np.asarray(clusters)[counted], return_inverse=True)
    if names.size < 2:
        return NO_INTERVAL
    sums = np.bincount(index, array[counted], names.size)
    sizes = np.bincount(index, minlength=names.size)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(names.size, np.full(names.size, 1 / names.size), RESAMPLES)
    means = (drawn @ sums) / (drawn @ sizes)
    tail = 100 * (1 - coverage) / 2
    low, high = np.percentile(means, (tail, 100 - tail))
    return float(low), float(high)
