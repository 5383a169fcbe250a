"""Fragments: the compressed sound around one range, in which a dish's whole echo lies."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from ertis_detector.imaging import RATE_HZ

FRAGMENT_SAMPLES = 192  # of the baseband; 1.14 ms: 20 cm of range
# A dish's vertex is heard at most 0.2 ms before its rings, its last bounces 0.1 ms after them;
# what is further away is somebody else's.
_BEFORE_S, _AFTER_S, _EDGE_S = 0.30e-3, 0.25e-3, 0.10e-3


@cache
def hann(num_samples: int) -> npt.NDArray[np.float32]:
    """Hann taper, float32 (num_samples,): both ends are silent."""
    window = np.hanning(num_samples).astype(np.float32)
    window.setflags(write=False)
    return window


@cache
def gate() -> npt.NDArray[np.float32]:
    """What a dish's echo is cut out with, float32 (FRAGMENT_SAMPLES,); its peak in the middle."""
    time_s = (np.arange(FRAGMENT_SAMPLES) - FRAGMENT_SAMPLES // 2) / RATE_HZ
    inside_s = np.where(time_s < 0, time_s + _BEFORE_S, _AFTER_S - time_s)
    window = np.sin(np.pi / 2 * np.clip(1 + inside_s / _EDGE_S, 0, 1)) ** 2
    window = window.astype(np.float32)
    window.setflags(write=False)
    return np.asarray(window)
