"""Fragments: 1024 audio samples' time of compressed sound around one range, tapered."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

FRAGMENT_SAMPLES = 384  # of the baseband; 1024 of audio: 2.28 ms: +-19.5 cm of range at 343 m/s


@cache
def hann(num_samples: int) -> npt.NDArray[np.float32]:
    """Hann taper, float32 (num_samples,): both ends are silent."""
    window = np.hanning(num_samples).astype(np.float32)
    window.setflags(write=False)
    return window


def taper(fragments: npt.NDArray[np.complex64]) -> npt.NDArray[np.complex64]:
    """Taper fragments, complex64 (num_fragments, num_samples), toward both ends."""
    return np.asarray(fragments * hann(fragments.shape[1]))
