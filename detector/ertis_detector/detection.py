"""What the detector says of one landmark in one ping."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

NONE, UNKNOWN = "none", "unknown"


def is_landmark(label: str) -> bool:
    """Whether a label is a size."""
    return label not in (NONE, UNKNOWN)


def landmark_mask(classes: Sequence[str]) -> npt.NDArray[np.bool_]:
    """Which classes are sizes, shape (num_classes,)."""
    return np.array([is_landmark(label) for label in classes])


def radius_m(label: str) -> float | None:
    """Aperture radius that a label such as ``r48`` names, m; None for ``none`` and ``unknown``.

    >>> radius_m("r48")
    0.048
    """
    if label.startswith("r") and label[1:].isdigit():
        return int(label[1:]) / 1000.0
    return None


@dataclass(frozen=True, slots=True)
class Detection:
    """One landmark heard in one ping.

    label : str
        The most probable size, ``r35 r48 r58 r70`` (aperture radius in mm).
    probabilities : mapping label -> probability
        Over all classes of the model, ``none`` and ``unknown`` included; they sum to 1.
    range_m, azimuth_rad, elevation_rad : float
        Of the dish's vertex, seen from the centre of the microphone array; + left, + up.
    covariance : 3 x 3 nested tuples
        Of (range, azimuth, elevation); m2, m rad, rad2.
    snr_db : float
        Peak of the energyscape over its noise floor, dB.
    tilt_rad : float
        Angle between the dish's axis and the line of sight; NaN where the echo does not tell.
    """

    label: str
    probabilities: Mapping[str, float]
    range_m: float
    azimuth_rad: float
    elevation_rad: float
    covariance: tuple[tuple[float, float, float], ...]
    snr_db: float
    tilt_rad: float = math.nan

    @property
    def landmark_probability(self) -> float:
        """That it is a landmark, of whichever size."""
        return sum(p for label, p in self.probabilities.items() if is_landmark(label))

    @property
    def radius_m(self) -> float | None:
        """Aperture radius of the landmark, m."""
        return radius_m(self.label)
