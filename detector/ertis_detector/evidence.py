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

from ertis_detector.detection import NONE, UNKNOWN, landmark_mask
from ertis_detector.motion import Float
from ertis_detector.rates import DetectorRates
from ertis_detector.views import CLASS_LENGTHS, likeness

PERSISTENT_PART = 0.3  # of what misleads, what does so from every side; measured like the lengths
NOISE_PART = 0.15  # what two pings from one spot do not share; measured, docs/tracker.md
MAX_VIEWS = 12
_SAME_VIEW = 0.95  # so alike, two views are one that counts twice
# Of 382,736 echoes in simulated drives none was told to be a landmark by more than 1 - 2e-4.
_FLOOR = 1e-4
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
        self._is_size = landmark_mask(self._labels)
        self._num_sizes = int(self._is_size.sum())
        each = rates.precision / max(self._num_sizes, 1)
        share = np.where(self._is_size, each, (1.0 - rates.precision) / 2)
        self._log_prior = np.log(share)
        self._unlike_sizes = ~self._is_size
        self._log_rest = _log_sum(self._log_prior[self._unlike_sizes])
        # Rows of views, one more than stay; and how alike each two of them are.
        self._num_views = 0
        self._views = np.zeros((MAX_VIEWS + 1, 3))
        self._said = np.zeros((MAX_VIEWS + 1, len(self._labels)))
        self._counts = np.zeros(MAX_VIEWS + 1)
        self._alike = np.zeros((MAX_VIEWS + 1, MAX_VIEWS + 1))
        self._of_first = 0.0
        self._alone = np.zeros(len(self._labels))
        self._repeats = 0.0
        self._total = np.zeros(len(self._labels))
        self._shares = self._is_size / max(self._num_sizes, 1)
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
        said -= _log_sum(told[self._unlike_sizes]) - self._log_rest
        again = math.log(detectable / self._rates.chance)
        if self._num_views == 0:
            self._of_first = again
        else:
            self._repeat(math.log(detectable) + log_likeness_to_chance)
        self._alone += said
        self._add(view, said + again * self._is_size)

    def missed(self, view: Float, detectable: float) -> None:
        """Take in that nothing was reported, where a landmark would have been, so probably."""
        silence = math.log((1.0 - detectable) / (1.0 - self._rates.chance))
        self._repeat(math.log(1.0 - detectable))
        self._add(view, np.where(self._is_size, silence, 0.0))

    def size_share(self) -> dict[str, float]:
        """Probability of each size, given that it is a landmark."""
        shares = zip(self._labels, self._shares.tolist(), self._is_size, strict=True)
        return {label: share for label, share, is_size in shares if is_size}

    def probabilities(self) -> dict[str, float]:
        """Of every class, ``none`` and ``unknown`` included; they sum to 1."""
        precision = self._rates.precision
        odds = math.log(precision / (1.0 - precision)) + self.existence
        is_landmark = 1.0 / (1.0 + math.exp(-min(max(odds, -700.0), 700.0)))
        rest = np.where(self._is_size, -math.inf, self._log_prior + self._total)
        other = np.exp(rest - _log_sum(rest[self._unlike_sizes]))
        whole = is_landmark * self._shares + (1.0 - is_landmark) * other
        return {label: float(p) for label, p in zip(self._labels, whole, strict=True)}

    def _repeat(self, nats: float) -> None:
        self._repeats = min(max(self._repeats + nats, _MIN_REPEATS), _MAX_REPEATS)

    def _add(self, view: Float, said: Float) -> None:
        n = self._num_views
        alike = likeness(self._views[:n], view, CLASS_LENGTHS)
        nearest = int(alike.argmax()) if n else 0
        if n and alike[nearest] > _SAME_VIEW:
            self._counts[nearest] += 1.0
            self._said[nearest] += (said - self._said[nearest]) / self._counts[nearest]
        else:
            self._num_views = n + 1
            self._views[n], self._said[n], self._counts[n] = view, said, 1.0
            self._relate(n, alike)
            if self._num_views > MAX_VIEWS:
                self._join_nearest()
        self._total = self._weights() @ self._said[: self._num_views]
        sizes = self._is_size
        if self._num_sizes:
            thing = _log_sum(self._total[sizes]) - self._of_first
            chance = _log_sum(self._alone[sizes]) + self._repeats
            self._existence = min(thing, chance) - math.log(self._num_sizes)
            share = np.exp(self._total - self._total[sizes].max()) * sizes
            self._shares = share / share.sum()

    def _relate(self, row: int, alike: Float) -> None:
        """Note how alike a view is to the first ones; to itself, less than to any of them."""
        self._alike[row, : alike.size] = self._alike[: alike.size, row] = alike
        self._alike[row, row] = -1.0

    def _weights(self) -> Float:
        """How much each view counts: C^-1 1, C the correlation of what they say.

        For jointly Gaussian log-likelihood ratios of one variance that is their exact sum: two
        equal views count half each, two independent ones count fully.
        """
        n = self._num_views
        persistent = (1.0 - NOISE_PART) * PERSISTENT_PART
        shared = persistent + (1.0 - NOISE_PART - persistent) * self._alike[:n, :n]
        shared.flat[:: n + 1] = (1.0 - NOISE_PART) + NOISE_PART / self._counts[:n]
        return np.asarray(np.linalg.solve(shared, np.ones(n)))

    def _join_nearest(self) -> None:
        """Make one of the two views that are most alike: nothing is forgotten, only blurred."""
        a, b = divmod(int(self._alike.argmax()), MAX_VIEWS + 1)
        part = self._counts[b] / (self._counts[a] + self._counts[b])
        self._views[a] += part * (self._views[b] - self._views[a])
        self._said[a] += part * (self._said[b] - self._said[a])
        self._counts[a] += self._counts[b]
        for rows in (self._views, self._said, self._counts, self._alike, self._alike.T):
            rows[b:-1] = rows[b + 1 :]
        self._num_views -= 1
        self._counts[self._num_views] = 0.0
        self._relate(a, likeness(self._views[: self._num_views], self._views[a], CLASS_LENGTHS))


def _log_sum(values: Float) -> float:
    terms = values.tolist()
    top: float = max(terms)
    if not math.isfinite(top):
        return top
    return top + math.log(sum(math.exp(term - top) for term in terms))
