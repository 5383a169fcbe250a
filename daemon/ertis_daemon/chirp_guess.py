"""Which chirp a recording without metadata holds, heard from the direct path."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, Chirp
from ertis_driver.frame import AUDIO_RATE_HZ

KNOWN_CHIRPS = (DEFAULT_CHIRP, INCUMBENT_CHIRP)
_HEARD = 5.0  # passive pings stay below 4, chirps begin at 15
_DIRECT_PATH_SAMPLES = 1_600  # 3.6 ms: the chirp's own 2.5 ms and the front's few centimetres


def guess_chirp(audio: npt.NDArray[np.float32]) -> Chirp | None:
    """The known chirp that compresses the direct path best; None if nothing was emitted.

    Parameters
    ----------
    audio : float32, shape (num_mics, num_samples)
        450 kHz.
    """
    start = audio[:, 8:_DIRECT_PATH_SAMPLES]
    scores = [_compression(start, chirp) for chirp in KNOWN_CHIRPS]
    best = int(np.argmax(scores))
    return KNOWN_CHIRPS[best] if scores[best] > _HEARD else None


def _compression(start: npt.NDArray[np.float32], chirp: Chirp) -> float:
    """Peak over median of the direct path's correlation with a chirp, median over microphones."""
    samples = chirp.samples(AUDIO_RATE_HZ)
    size = 4_096
    # Whitened: each frequency of the sweep counts alike, whatever the transducer makes of it.
    spectrum = np.fft.rfft(start, size, axis=1)
    phase = spectrum / np.maximum(np.abs(spectrum), 1e-9)
    reference = np.fft.rfft(samples, size)
    weight = np.abs(reference) > 0.2 * np.abs(reference).max()
    matched = phase * np.exp(-1j * np.angle(reference)) * weight
    response = np.abs(np.fft.irfft(matched, size, axis=1))
    gain = np.sqrt(size / 2 / weight.sum())
    return float(np.median(response[:, :400].max(axis=1) / np.median(response, axis=1)) / gain)
