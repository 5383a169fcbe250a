"""What pings together say of one thing: is it a landmark, and of which size.

Everything is a log-likelihood ratio against "no landmark". Two ways to be no landmark are kept
apart, and the track is as good as the better excuse leaves it:

- a thing that stands there and is taken for a landmark. It is heard again as a landmark would be,
  so being heard again proves little: from the same spot it sounds the same, and some things sound
  wrong from everywhere. Pings count by how much their views differ.
- nothing that lasts: a false alarm now, and perhaps another one nearby by chance. Silence where
  a landmark would be heard speaks for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ertis_detector.detection import NONE, UNKNOWN
from ertis_detector.motion import Float
from ertis_detector.rates import DetectorRates
from ertis_detector.views import CLASS_LENGTHS, likeness

PERSISTENT_PART = 0.3  # of what misleads, what does so from every side; measured like the lengths
NOISE_PART = 0.15  # what two pings from one spot do not share; measured, docs/tracker.md
MAX_VIEWS = 12
_FLOOR = 3e-4  # some thousands of echoes show no better how well probabilities are calibrated
_MAX_REPEATS, _MIN_REPEATS = 30.0, -10.0  # nats; bounded, so that a change is noticed in time


class Evidence:
    """Accumulates what is heard of one thing.

    Parameters
    ----------
    rates : DetectorRates
    labels : of all classes, ``none`` and ``unknown`` included
    """

    def __init__(self, rates: DetectorRates, labels: Sequence[str]) -> None:
        self._rates = rates
        self._labels = tuple(dict.fromkeys([*labels, NONE, UNKNOWN]))
        self._is_size = np.array([label not in (NONE, UNKNOWN) for label in self._labels])
        sizes = max(int(self._is_size.sum()), 1)
        share = np.where(self._is_size, rates.precision / sizes, (1.0 - rates.precision) / 2)
        self._log_prior = np.log(share)
        self._views = np.empty((0, 3))
        self._said = np.empty((0, len(self._labels)))
        self._counts = np.empty(0)
        self._of_first = 0.0
        self._alone = np.zeros(len(self._labels))
        self._repeats = 0.0
        self._total = np.zeros(len(self._labels))
        self._existence = -math.inf

    @property
    def labels(self) -> tuple[str, ...]:
        """In the order of first mention."""
        return self._labels

    @property
    def existence(self) -> float:
        """Log-likelihood ratio of a landmark, of any size, against none; after one false alarm.

        What the first report says by being there is left out: false alarms are counted by reports.
        """
        return self._existence

    def heard(
        self,
        view: Float,
        probabilities: Mapping[str, float],
        detectable: float,
        log_likeness_to_chance: float = 0.0,
    ) -> None:
        """Take in a detection.

        Parameters
        ----------
        view : float64, shape (3,)
        probabilities : of every class
        detectable : float
            Probability that a landmark there is reported at all.
        log_likeness_to_chance : float
            Log of how much likelier it is there than a false alarm anywhere; 0 for the first.
        """
        told = np.log([max(probabilities.get(label, 0.0), _FLOOR) for label in self._labels])
        said = told - self._log_prior
        # Against "no landmark" as a whole: none and unknown together.
        said -= _log_sum(told[~self._is_size]) - _log_sum(self._log_prior[~self._is_size])
        again = math.log(detectable / self._rates.chance)
        if self._counts.size == 0:
            self._of_first = again
        else:
            self._repeat(math.log(detectable) + log_likeness_to_chance)
        self._alone += said
        self._add(view, said + again * self._is_size)

    def missed(self, view: Float, detectable: float) -> None:
        """Take in that nothing was reported, where a landmark would have been, so probably."""
        silence = math.log((1.0 - detectable) / (1.0 - self._rates.chance))
        self._repeat(math.log(1.0 - detectable))
        self._add(view, silence * self._is_size)

    def size_share(self) -> dict[str, float]:
        """Probability of each size, given that it is a landmark."""
        shares = zip(self._labels, self._shares(), self._is_size, strict=True)
        return {label: float(share) for label, share, is_size in shares if is_size}

    def probabilities(self) -> dict[str, float]:
        """Of every class, ``none`` and ``unknown`` included; they sum to 1."""
        precision = self._rates.precision
        odds = math.log(precision / (1.0 - precision)) + self.existence
        is_landmark = 1.0 / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
        rest = np.where(self._is_size, -math.inf, self._log_prior + self._total)
        other = np.exp(rest - _log_sum(rest[~self._is_size]))
        whole = is_landmark * self._shares() + (1.0 - is_landmark) * other
        return {label: float(p) for label, p in zip(self._labels, whole, strict=True)}

    def _shares(self) -> Float:
        sizes = np.where(self._is_size, self._total, -math.inf)
        share = np.exp(sizes - sizes.max()) * self._is_size
        return np.asarray(share / share.sum())

    def _repeat(self, nats: float) -> None:
        self._repeats = min(max(self._repeats + nats, _MIN_REPEATS), _MAX_REPEATS)

    def _add(self, view: Float, said: Float) -> None:
        self._views = np.vstack([self._views, view])
        self._said = np.vstack([self._said, said])
        self._counts = np.append(self._counts, 1.0)
        if self._counts.size > MAX_VIEWS:
            self._join_nearest()
        self._total = self._weights() @ self._said
        sizes = self._is_size
        if sizes.any():
            thing = _log_sum(self._total[sizes]) - self._of_first
            chance = _log_sum(self._alone[sizes]) + self._repeats
            self._existence = min(thing, chance) - math.log(sizes.sum())

    def _weights(self) -> Float:
        """How much each view counts: C^-1 1, C the correlation of what they say.

        For jointly Gaussian log-likelihood ratios of one variance that is their exact sum: two
        equal views count half each, two independent ones count fully.
        """
        alike = likeness(self._views[:, None], self._views[None, :], CLASS_LENGTHS)
        shared = (1.0 - NOISE_PART) * (PERSISTENT_PART + (1.0 - PERSISTENT_PART) * alike)
        shared[np.diag_indices_from(shared)] += NOISE_PART / self._counts
        return np.asarray(np.linalg.solve(shared, np.ones(len(shared))))

    def _join_nearest(self) -> None:
        """Make one of the two views that are most alike: nothing is forgotten, only blurred."""
        alike = likeness(self._views[:, None], self._views[None, :], CLASS_LENGTHS)
        np.fill_diagonal(alike, -1.0)
        a, b = np.unravel_index(int(alike.argmax()), alike.shape)
        part = self._counts[b] / (self._counts[a] + self._counts[b])
        self._views[a] += part * (self._views[b] - self._views[a])
        self._said[a] += part * (self._said[b] - self._said[a])
        self._counts[a] += self._counts[b]
        self._views, self._said = np.delete(self._views, b, 0), np.delete(self._said, b, 0)
        self._counts = np.delete(self._counts, b)


def _log_sum(values: Float) -> float:
    top = float(values.max())
    return top + math.log(float(np.exp(values - top).sum())) if math.isfinite(top) else top
