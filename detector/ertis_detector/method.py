"""What a method that is told the range is given, and what it must do: the strict protocol's side.

A method is the paper's (``paper.py``), or anything else that says which landmark stands at a known
range. All are run on the same splits of the same pings (``protocol.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air


@dataclass(frozen=True, slots=True, eq=False)
class KnownRangePing:
    """One ping, and where its label points.

    audio : float32, shape (num_mics, num_samples)
        450 kHz.
    range_m : float
        To the landmark's vertex, or to where one would be.
    azimuth_rad : float
        Of the same; NaN where nobody measured it.
    air : Air
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    chirp_band_hz : (low, high)
    chirp_name : str
        What models call it.
    mic_positions_m : float64, shape (num_mics, 3)
    emitter_position_m : float64, shape (3,)
    """

    audio: npt.NDArray[np.float32]
    range_m: float
    azimuth_rad: float
    air: Air
    chirp: npt.NDArray[np.float64]
    chirp_band_hz: tuple[float, float]
    chirp_name: str
    mic_positions_m: npt.NDArray[np.float64]
    emitter_position_m: npt.NDArray[np.float64]


class Method(Protocol):
    """Says which landmark, if any, stands at the range that it is told.

    It must survive pickling before ``fit``: folds are dealt out to processes.
    """

    @property
    def name(self) -> str:
        """What tables call it."""

    def prepare(self, ping: KnownRangePing) -> npt.NDArray[Any]:
        """What it needs of one ping, of one shape for all pings; sees no label."""

    def fit(self, prepared: npt.NDArray[Any], labels: Sequence[str]) -> None:
        """Learn anew from prepared pings, stacked along the first axis."""

    def predict(self, prepared: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        """Probabilities, shape (n, num_classes), in the order of ``classes``; rows sum to 1."""

    @property
    def classes(self) -> tuple[str, ...]:
        """What it was fitted to tell apart: the landmarks' labels, and ``none``."""
