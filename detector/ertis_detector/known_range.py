"""The detector where the range is known: which landmark stands there, if any.

The paper is told the range and cuts out +-20 cm of it; this looks at the same piece of every
direction's echo, with the model that was trained on other scenes. Only how its say becomes the
answer for a whole ping is learnt from the pings given.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_detector.detection import landmark_mask
from ertis_detector.method import KnownRangePing
from ertis_detector.model import Model, load_model, shipped_model
from ertis_detector.scanner import Scanner

GATE_M = 0.20  # the paper's
_REACH_M = 0.05  # behind the gate: the ring of the largest dish, whose vertex is in it
_LEAST = 1e-4


class KnownRangeDetector:
    """A ``Method``: the shipped detector, told the range."""

    name = "ours"

    def __init__(self) -> None:
        self._model: Model | None = None
        self._scanner: tuple[Air, Scanner] | None = None
        self._law: Any = None

    @property
    def classes(self) -> tuple[str, ...]:
        """What it was fitted to tell apart."""
        return tuple(str(name) for name in self._law.classes_)

    def prepare(self, ping: KnownRangePing) -> npt.NDArray[np.float64]:
        """Best log-odds of each size, and of any, among the echoes in the gate; shape (n,).

        Raises
        ------
        DetectorError
            If no model ships for the chirp, or the ping is of another length than the first.
        """
        model, scanner = self._model_for(ping), self._scanner_for(ping)
        baseband, scape = scanner.image(ping.audio)
        gate = ping.range_m - GATE_M, ping.range_m + GATE_M + _REACH_M
        sizes = np.flatnonzero(landmark_mask(model.classes))
        candidates = scanner.candidates(baseband, scape, gate)
        if not candidates:
            return np.full(len(sizes) + 1, np.log(_LEAST))
        rows = model.classifier.probabilities(scanner.features(baseband, candidates))
        told = np.asarray(rows[:, sizes], np.float64)
        best = np.concatenate([told.max(axis=0), [told.sum(axis=1).max()]])
        best = np.clip(best, _LEAST, 1 - _LEAST)
        return np.asarray(np.log(best / (1 - best)))

    def fit(self, prepared: npt.NDArray[np.float64], labels: Sequence[str]) -> None:
        """Learn anew how log-odds become an answer: multinomial logistic regression."""
        from sklearn.linear_model import LogisticRegression

        self._law = LogisticRegression(C=1.0, max_iter=2000).fit(prepared, list(labels))

    def predict(self, prepared: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Probabilities, shape (n, num_classes), in the order of ``classes``."""
        return np.asarray(self._law.predict_proba(prepared))

    def _model_for(self, ping: KnownRangePing) -> Model:
        if self._model is None:
            self._model = load_model(shipped_model(ping.chirp_name))
        return self._model

    def _scanner_for(self, ping: KnownRangePing) -> Scanner:
        if self._scanner is None or self._scanner[0] != ping.air:
            scanner = Scanner(
                mic_positions_m=ping.mic_positions_m,
                emitter_position_m=ping.emitter_position_m,
                chirp_samples=ping.chirp,
                chirp_band_hz=ping.chirp_band_hz,
                num_samples=ping.audio.shape[1],
                air=ping.air,
            )
            self._scanner = ping.air, scanner
        return self._scanner[1]

    def __getstate__(self) -> dict[str, Any]:
        """For other processes: what ``prepare`` keeps is made again there."""
        return {"_model": None, "_scanner": None, "_law": self._law}
