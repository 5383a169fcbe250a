"""What a classifier says of echoes of known kind: a threshold, and figures for a model's card."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_daemon.training_rows import TrainingRows
from ertis_detector.detection import NONE, UNKNOWN, landmark_mask

# A wrong landmark is worse than none: of clutter, one false detection a minute at 7 pings a second;
# of bowls and lampshades in view, one in fifty.
MAX_FALSE_PER_PING, MAX_DECOYS_REPORTED = 1 / 420, 0.02
# Probabilities are to come true where a landmark is in sight in every other ping: decision 9.
IN_SIGHT = 0.5
GREATEST_THRESHOLD = 0.999  # of 1, nothing would ever be reported


def weights_of(rows: TrainingRows) -> tuple[npt.NDArray[np.float64], float]:
    """How often each row's ping is met where probabilities must come true, and what part of pings.

    Where nearly all pings here have a landmark in sight, or nearly none has, they are left as they
    are: few would have to speak for many.
    """
    share = rows.pings_in_sight / max(rows.pings, 1)
    if not 0.1 <= share <= 0.9:
        return np.ones(len(rows.labels)), share
    met = np.where(rows.in_sight, IN_SIGHT / share, (1 - IN_SIGHT) / (1 - share))
    return met, IN_SIGHT


class Reports:
    """What is said of each candidate of scenes left out, whether or not it would be reported."""

    def __init__(
        self,
        classes: tuple[str, ...],
        probabilities: npt.NDArray[np.float32],
        rows: TrainingRows,
        weights: npt.NDArray[np.float64],
    ) -> None:
        landmark = landmark_mask(classes)
        chosen = probabilities[:, landmark]
        self.probability: npt.NDArray[np.float32] = chosen.sum(axis=1)
        truth = np.asarray(rows.labels)
        self.is_none, self.is_decoy = truth == NONE, truth == UNKNOWN
        self.is_clutter = self.is_none & rows.teaches
        self.is_landmark = ~(self.is_none | self.is_decoy) & rows.teaches
        self.size_right = np.asarray(classes)[landmark][chosen.argmax(axis=1)] == truth
        self.pings, self.weight = rows.pings, weights

    def threshold(self) -> float:
        """Least probability from 0.5 on at which false reports are rare enough."""
        by_clutter = self._rarer_than(self.is_clutter, MAX_FALSE_PER_PING * self.pings)
        decoys = self.weight[self.is_decoy].sum()
        by_decoys = self._rarer_than(self.is_decoy, MAX_DECOYS_REPORTED * decoys)
        return round(min(max(0.5, by_clutter, by_decoys), GREATEST_THRESHOLD), 3)

    def figures(self, threshold: float) -> dict[str, float]:
        """Of located proposals, not of dishes, on scenes left out.

        Of as many pings, weighted to have a landmark in sight as often as the card says.
        """
        reported = self.probability >= threshold
        found = reported & self.is_landmark
        right = found & self.size_right
        landmarks, located = self._sum(self.is_landmark), self._sum(found)
        misled = self._sum(reported & self.is_decoy)
        false = misled + self._sum(reported & self.is_none)
        return {
            "proposals": round(self._sum(self.is_landmark | self.is_none | self.is_decoy), 1),
            "landmark_proposals": round(landmarks, 1),
            "precision": _part(located, located + false),
            "found": _part(located, landmarks),
            "found_with_right_size": _part(self._sum(right), landmarks),
            "size_right_if_found": _part(self._sum(right), located),
            "false_alarms_per_ping": round(false / self.pings, 5),
            "decoys_reported": _part(misled, self._sum(self.is_decoy)),
        }

    def _sum(self, which: npt.NDArray[np.bool_]) -> float:
        return float(self.weight[which].sum())

    def _rarer_than(self, which: npt.NDArray[np.bool_], allowed: float) -> float:
        """Least threshold, in thousandths, that at most so many reach; 0 if all may."""
        order = np.argsort(self.probability[which])[::-1]
        ranked = self.probability[which][order]
        too_many = np.cumsum(self.weight[which][order]) > allowed
        if not too_many.any():
            return 0.0
        return float(np.floor(1000 * ranked[too_many.argmax()] + 1) / 1000)


def _part(some: float, of: float) -> float:
    return round(some / of, 4) if of else 0.0
