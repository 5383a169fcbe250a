"""Peaks of impulse responses: when, and how strong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.imaging import AUDIO_RATE_HZ

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

MAX_PEAKS = 12
# Below the strongest peak: deeper ones are clutter more often than they are a vertex, and the
# division's own side lobes lie 43 dB down.
DYNAMIC_RANGE_DB = 26.0


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Peaks of fragments, strongest first; NaN where there are no more.

    time_s : float64, shape (n, MAX_PEAKS)
        After the time of the range that was told.
    level_db : float64, shape (n, MAX_PEAKS)
        Scattering length re 1 m, if the response was divided by the emission at 1 m.
    threshold_db : float64, shape (n,)
        No weaker peak was looked for.
    """

    time_s: Float
    level_db: Float
    threshold_db: Float

    def as_array(self) -> Float:
        """All of it, shape (n, 2 MAX_PEAKS + 1)."""
        return np.concatenate([self.time_s, self.level_db, self.threshold_db[:, None]], axis=1)

    @classmethod
    def from_array(cls, array: Float) -> Peaks:
        """What ``as_array`` made."""
        if array.ndim != 2 or array.shape[1] != 2 * MAX_PEAKS + 1:
            raise ValueError(
                f"peaks of shape {array.shape}, expected (n, {2 * MAX_PEAKS + 1}): as as_array "
                "makes them"
            )
        return cls(array[:, :MAX_PEAKS], array[:, MAX_PEAKS:-1], array[:, -1])


def find_peaks(response: Complex, range_m: Float, centre: int) -> Peaks:
    """The strongest local maxima of the envelope, between samples by a parabola.

    Parameters
    ----------
    response : complex128, shape (n, num_samples)
        Impulse responses at 450 kHz.
    range_m : shape (n,)
        Told; spreading over twice that way is taken out of the levels.
    centre : int
        Sample at the time of that range.
    """
    level = 20 * np.log10(np.abs(response) + 1e-12) + 40 * np.log10(range_m)[:, None]
    threshold = level.max(axis=1) - DYNAMIC_RANGE_DB
    before, here, after = level[:, :-2], level[:, 1:-1], level[:, 2:]
    is_peak = (here >= before) & (here > after) & (here > threshold[:, None])
    ranked = np.where(is_peak, here, -np.inf)
    chosen = np.argsort(-ranked, axis=1)[:, :MAX_PEAKS]
    left, top, right = (np.take_along_axis(side, chosen, 1) for side in (before, here, after))
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = (left - right) / (2 * (left - 2 * top + right))
    time_s = (chosen + 1 + shift - centre) / AUDIO_RATE_HZ
    missing = ~np.isfinite(np.take_along_axis(ranked, chosen, 1))
    height = top - (left - right) * shift / 4
    time_s[missing], height[missing] = np.nan, np.nan
    # Where more were found than are kept, nothing under the weakest kept was looked for.
    full = ~missing[:, -1]
    threshold = np.where(full, np.maximum(threshold, height[:, -1]), threshold)
    return Peaks(time_s, height, threshold)
