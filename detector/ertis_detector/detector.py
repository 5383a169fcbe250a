"""Audio of one ping to detections: scan, classify, say where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import UNKNOWN, Detection, landmark_mask
from ertis_detector.imaging import Complex, Energyscape
from ertis_detector.model import Model
from ertis_detector.scanner import Candidate, Scanner

# Two reports nearer to each other than this are of one dish.
_SAME_RANGE_M, _SAME_BEARING_RAD = 0.12, np.deg2rad(8.0)


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """One ping, compressed and imaged, and what stands out in it."""

    baseband: Complex
    scape: Energyscape
    candidates: list[Candidate]


class LandmarkDetector:
    """Says which landmark is where.

    Parameters
    ----------
    model : Model
    scanner : Scanner
    chirp, audio_filter : str
        What the device emits and how its sound was decimated; they must be the model's.
    min_probability : float
        Reported is what is a landmark, of whichever size, with this probability at least; None
        for the model's own.

    Raises
    ------
    ModelMismatch
    """

    def __init__(
        self,
        model: Model,
        scanner: Scanner,
        *,
        chirp: str,
        audio_filter: str,
        min_probability: float | None = None,
    ) -> None:
        model.check(chirp=chirp, audio_filter=audio_filter)
        self.model, self.scanner = model, scanner
        own = model.card.min_probability
        self.min_probability = own if min_probability is None else min_probability

    def detect(self, audio: npt.NDArray[np.float32]) -> list[Detection]:
        """Landmarks in one ping, most probable first.

        Parameters
        ----------
        audio : float32, shape (num_mics, num_samples)
            450 kHz.
        """
        return self.judge(self.scan(audio))

    def scan(self, audio: npt.NDArray[np.float32]) -> Scan:
        """What ``judge`` takes, and pictures are drawn of."""
        baseband, scape = self.scanner.image(audio)
        return Scan(baseband, scape, self.scanner.candidates(baseband, scape))

    def judge(self, scan: Scan) -> list[Detection]:
        """Landmarks among the candidates, most probable first."""
        if not scan.candidates:
            return []
        features = self.scanner.features(scan.baseband, scan.candidates)
        rows = self.model.classifier.probabilities(features)
        classes = self.model.classes
        sizes = np.flatnonzero(landmark_mask(classes))
        told = np.flatnonzero(rows[:, sizes].sum(axis=1) >= self.min_probability)
        if not told.size:
            return []
        labels = [classes[sizes[int(rows[i, sizes].argmax())]] for i in told]
        heard = [scan.candidates[i] for i in told]
        range_m, tilt, variances = self.model.readout(
            features[told],
            labels,
            np.array([one.location.range_m for one in heard]),
            np.array([one.snr_db for one in heard]),
        )
        found = [
            Detection(
                label,
                _named(classes, rows[i]),
                float(range_m[k]),
                one.location.azimuth_rad,
                one.location.elevation_rad,
                _diagonal(variances[k]),
                one.snr_db,
                float(tilt[k]),
            )
            for k, (i, one, label) in enumerate(zip(told, heard, labels, strict=True))
        ]
        found.sort(key=lambda one: -one.probabilities[one.label])
        return _each_once(found)


def _named(classes: tuple[str, ...], row: npt.NDArray[np.float32]) -> dict[str, float]:
    told = {name: float(p) for name, p in zip(classes, row, strict=True)}
    told.setdefault(UNKNOWN, 0.0)
    return told


def _diagonal(variances: npt.NDArray[np.float64]) -> tuple[tuple[float, float, float], ...]:
    rows = np.diag(variances).tolist()
    return tuple((row[0], row[1], row[2]) for row in rows)


def _each_once(found: list[Detection]) -> list[Detection]:
    """Leave out what is heard where something more probable is."""
    kept: list[Detection] = []
    for one in found:
        if not any(_same(one, other) for other in kept):
            kept.append(one)
    return kept


def _same(a: Detection, b: Detection) -> bool:
    return (
        abs(a.range_m - b.range_m) < _SAME_RANGE_M
        and abs(a.azimuth_rad - b.azimuth_rad) < _SAME_BEARING_RAD
        and abs(a.elevation_rad - b.elevation_rad) < 2 * _SAME_BEARING_RAD
    )
