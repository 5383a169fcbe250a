"""Which dish explains peaks: a likelihood over radii, with clutter as its alternative.

Each expected glint is found with some probability, at a time and level with some error, or not at
all; every other peak is clutter, a Poisson process in time. Against clutter alone a dish at time t
then has the likelihood ``prod_k (1 - p_k + sum_j p(peak j | glint k, t) / clutter(peak j))``. That
one peak cannot be two glints is left out, and so is all that glints do to each other when they
blur: what is asked is peaks, not a waveform.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr, logsumexp, ndtr

from ertis_detector.dish_pattern import DishPattern
from ertis_detector.peak_finding import Peaks

Float = npt.NDArray[np.float64]

TILTS_RAD = np.deg2rad([0.0, 10.0, 20.0, 30.0, 40.0])
_GAINS = np.array([-1.5, -0.75, 0.0, 0.75, 1.5])  # standard deviations of a dish's level
_BATCH = 8  # fragments at once: some 30 MB


@dataclass(frozen=True, slots=True)
class PeakStatistics:
    """What a pattern is weighed with; ``fitted`` learns the levels from labelled fragments.

    clutter_per_s : float
        Peaks of anything else, a second of impulse response.
    clutter_level_db, clutter_spread_db : float
        Mean and standard deviation of their levels (range taken out: scattering length re 1 m).
    gain_db, gain_spread_db : float
        Of all glints of a dish together, against the closed form.
    glint_spread_db : float
        Of each glint by itself.
    hidden : float
        Probability that a glint is not found though it is loud enough.
    timing_cycles : float
        Standard deviation of a peak's time, in units of 1 / bandwidth.
    range_std_m : float
        Of the range that is told.
    """

    clutter_per_s: float = 2000.0
    clutter_level_db: float = -45.0
    clutter_spread_db: float = 8.0
    gain_db: float = 0.0
    gain_spread_db: float = 4.0
    glint_spread_db: float = 6.0
    hidden: float = 0.2
    timing_cycles: float = 0.15
    range_std_m: float = 0.02


class PatternLikelihood:
    """Likelihood of radii, from peaks.

    Parameters
    ----------
    radii_m : shape (num_radii,)
    centre_hz, bandwidth_hz : float
        Of the impulse responses: see ``Deconvolution``.
    speed_of_sound_m_s : float
    statistics : PeakStatistics
    tilts_rad : shape (num_tilts,)
        Turned dishes that are thought of, each as likely.

    Raises
    ------
    ValueError
        If there is no radius, or one is not positive.
    """

    def __init__(
        self,
        radii_m: Float,
        centre_hz: float,
        bandwidth_hz: float,
        speed_of_sound_m_s: float,
        statistics: PeakStatistics,
        tilts_rad: Float = TILTS_RAD,
    ) -> None:
        if radii_m.ndim != 1 or not radii_m.size or not np.all(radii_m > 0):
            raise ValueError(f"radii {radii_m!r}, expected one or more lengths in m above 0")
        self.radii_m, self.speed_of_sound_m_s = radii_m, speed_of_sound_m_s
        self.statistics = statistics
        self.timing_s = statistics.timing_cycles / bandwidth_hz
        self.pattern = DishPattern.of(radii_m, tilts_rad, centre_hz, speed_of_sound_m_s)

    def log_ratios(self, peaks: Peaks) -> Float:
        """Log likelihood of each radius against clutter alone, shape (n, num_radii)."""
        parts = [
            self._log_ratios(
                peaks.time_s[first : first + _BATCH],
                peaks.level_db[first : first + _BATCH],
                peaks.threshold_db[first : first + _BATCH],
            )
            for first in range(0, len(peaks.time_s), _BATCH)
        ]
        return np.concatenate(parts) if parts else np.empty((0, self.radii_m.size))

    def probabilities(self, peaks: Peaks, *, log_odds_of_none: float = 0.0) -> Float:
        """Probabilities of each radius and, last, of none: shape (n, num_radii + 1).

        Parameters
        ----------
        peaks : Peaks
        log_odds_of_none : float
            Of no dish against any, before anything is heard.
        """
        of_each = self.log_ratios(peaks) - np.log(self.radii_m.size)
        joint = np.concatenate([of_each, np.full((len(of_each), 1), log_odds_of_none)], axis=1)
        return np.asarray(np.exp(joint - logsumexp(joint, axis=1, keepdims=True)))

    def _log_ratios(self, time_s: Float, level_db: Float, threshold_db: Float) -> Float:
        """Of a few fragments: the time of the deepest point, tilt and gain are summed over."""
        said, step_s = self.statistics, self.timing_s / 2
        weight, found = self._against_clutter(level_db, threshold_db)
        reach_s = 3 * 2 * said.range_std_m / self.speed_of_sound_m_s
        origins_s = np.arange(-reach_s, reach_s + step_s, step_s)
        delay = np.rint(self.pattern.delay_s / step_s).astype(int)
        least = int(delay.min())
        grid_s = origins_s[0] + step_s * np.arange(least, origins_s.size + int(delay.max()))
        off = (grid_s[None, :, None] - time_s[:, None, :]) / self.timing_s
        near = np.exp(-(np.where(np.isnan(off), np.inf, off) ** 2) / 2)
        near /= np.sqrt(2 * np.pi) * self.timing_s * said.clutter_per_s
        prior = _normal(origins_s / (reach_s / 3))
        likelihood = np.empty((len(time_s), *delay.shape[:2]))
        for radius, tilt in np.ndindex(*delay.shape[:2]):
            total = np.ones((len(time_s), origins_s.size, _GAINS.size))
            for glint, late in enumerate(delay[radius, tilt] - least):
                seen = near[:, late : late + origins_s.size] @ weight[:, radius, tilt, glint]
                seen += 1 - found[:, None, radius, tilt, glint]
                total *= seen
            likelihood[:, radius, tilt] = (total @ _normal(_GAINS)) @ prior
        return np.asarray(np.log(likelihood.mean(axis=2)))

    def _against_clutter(self, level_db: Float, threshold_db: Float) -> tuple[Float, Float]:
        """How much more a peak's level speaks for a glint than for clutter; is the glint found.

        Returns
        -------
        shapes (n, num_radii, num_tilts, num_glints, MAX_PEAKS, num_gains) and the same without
        MAX_PEAKS
        """
        said = self.statistics
        gains = said.gain_db + said.gain_spread_db * _GAINS
        expected = self.pattern.level_db[..., None] + gains
        over = (expected[None] - threshold_db[:, None, None, None, None]) / said.glint_spread_db
        off = (level_db[:, None, None, None, :, None] - expected[None, ..., None, :]) / (
            said.glint_spread_db
        )
        log_glint = -(off**2) / 2 - np.log(said.glint_spread_db)
        other = (level_db - said.clutter_level_db) / said.clutter_spread_db
        under = (threshold_db - said.clutter_level_db) / said.clutter_spread_db
        log_clutter = -(other**2) / 2 - np.log(said.clutter_spread_db) - log_ndtr(-under)[:, None]
        ratio = np.exp(log_glint - log_clutter[:, None, None, None, :, None])
        ratio = np.where(np.isnan(ratio), 0.0, ratio) * (1 - said.hidden)
        return ratio, ndtr(over) * (1 - said.hidden)


def log_evidence(log_ratios: Float) -> Float:
    """Log likelihood of any dish, each radius as likely, against clutter alone; shape (n,)."""
    return np.asarray(logsumexp(log_ratios, axis=1) - np.log(log_ratios.shape[1]))


def _normal(deviations: Float) -> Float:
    """Weights of evenly spaced standard deviations, of sum 1."""
    weight = np.exp(-(deviations**2) / 2)
    return np.asarray(weight / weight.sum())


def fitted_statistics(
    start: PeakStatistics, peaks: Peaks, expected_db: Float, span_s: float
) -> PeakStatistics:
    """Learn levels and density from labelled fragments.

    Parameters
    ----------
    start : PeakStatistics
        What is kept where nothing can be learnt.
    peaks : Peaks
    expected_db : shape (n,)
        Level of the strongest glint of the dish that is there, seen from the front; NaN for none.
    span_s : float
        Of a fragment.
    """
    none = np.isnan(expected_db)
    learnt = start
    if none.any():
        levels = peaks.level_db[none]
        per_s = np.isfinite(levels).sum() / (none.sum() * span_s)
        learnt = replace(
            learnt,
            clutter_per_s=float(max(per_s, 1 / span_s)),
            clutter_level_db=float(np.nanmean(levels)),
            clutter_spread_db=max(float(np.nanstd(levels)), 3.0),
        )
    if not none.all():
        over = peaks.level_db[~none, 0] - expected_db[~none]
        middle = np.median(over)
        spread = 1.4826 * np.median(np.abs(over - middle))
        learnt = replace(
            learnt, gain_db=float(middle), gain_spread_db=float(np.clip(spread, 2.0, 10.0))
        )
    return learnt
