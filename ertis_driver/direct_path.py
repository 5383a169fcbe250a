"""Was this chirp emitted? What the microphones hear on the direct way from the emitter tells.

The device's hash of a chirp is blind to order; the air is not: a matched filter compresses the
chirp that was emitted and smears its time reversal. It does not tell apart different sweeps of the
same direction through the same band: their responses differ too little on an overdriven microphone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import Emission
from ertis_driver.frame import AUDIO_RATE_HZ

SEARCH_S = 3e-3  # delays within which the direct path must begin: 5 cm take 0.15 ms
HEARD_PEAK_RATIO = 5.0  # peak over median; passive pings stay below 4, chirps begin at 15
FORWARD_DB = 6.0  # right chirps reach 11 and more, reversed ones fall below -9
MIRROR_LIKENESS = 0.5  # a chirp this like its own reversal (a plain tone) tells no direction
_START_UP_SAMPLES = 8  # word 0 is garbage
_BAND_FLOOR = 0.2  # of the strongest frequency: what the sweep holds


@dataclass(frozen=True, slots=True)
class DirectPath:
    """What a matched filter finds in the first 3 ms.

    heard : bool
        This chirp, played forward.
    delay_s : float
        From word 0 to the chirp's beginning, median over microphones; NaN if not heard.
    peak_ratio : float
        Response's peak over its median, median over microphones.
    level_over_reversed_db : float
        Peak over that of the time-reversed chirp; NaN for a chirp that is its own reversal.
        Negative: it was played backward.
    """

    heard: bool
    delay_s: float
    peak_ratio: float
    level_over_reversed_db: float


def find_direct_path(
    audio: npt.NDArray[np.float32], chirp: Emission, rate_hz: int = AUDIO_RATE_HZ
) -> DirectPath:
    """Look for the direct path of a chirp.

    Parameters
    ----------
    audio : float32, shape (num_mics, num_samples)
        Of one active ping; at least 3 ms and the chirp's own length are looked at, if there.
    chirp
        What should have been emitted.
    rate_hz
        Of the audio: a tenth of the PDM clock.

    Raises
    ------
    ValueError
        If ``audio`` is no (num_mics, num_samples), or shorter than the chirp.
    """
    samples = chirp.samples(rate_hz)
    if audio.ndim != 2 or audio.shape[1] < len(samples):
        raise ValueError(
            f"audio of shape {audio.shape}, expected (num_mics, num_samples) with at least "
            f"{len(samples)} samples, the chirp's length"
        )
    num_delays = round(SEARCH_S * rate_hz)
    start = audio[:, _START_UP_SAMPLES : num_delays + len(samples)]
    forward = _response(start, samples)
    peak = forward[:, :num_delays].max(axis=1)
    ratio = float(np.median(peak / np.maximum(np.median(forward, axis=1), 1e-30)))
    backward = _response(start, samples[::-1])[:, :num_delays].max(axis=1)
    over_db = float(20 * np.log10(np.median(peak / np.maximum(backward, 1e-30)) + 1e-30))
    if _is_mirrored(samples):
        over_db = float("nan")
    heard = ratio > HEARD_PEAK_RATIO and not over_db < FORWARD_DB
    first = float(np.median(forward[:, :num_delays].argmax(axis=1))) + _START_UP_SAMPLES
    return DirectPath(heard, first / rate_hz if heard else float("nan"), ratio, over_db)


def _response(
    start: npt.NDArray[np.float32], samples: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Envelope of the whitened matched filter; float64, shape (num_mics, num_samples).

    Whitened, since the direct path overdrives the microphones and the transducer is 20 dB weaker
    at the ends of the sweep: each frequency of the sweep counts alike.
    """
    size = 1 << (start.shape[1] + len(samples) - 1).bit_length()
    heard = np.fft.rfft(start, size, axis=1)
    sweep = np.fft.rfft(samples, size)
    in_band = np.abs(sweep) > _BAND_FLOOR * np.abs(sweep).max()
    phase = heard / np.maximum(np.abs(heard), 1e-12)
    spectrum = np.zeros((len(start), size), np.complex128)
    spectrum[:, : len(sweep)] = phase * np.exp(-1j * np.angle(sweep)) * in_band
    return np.asarray(np.abs(np.fft.ifft(spectrum, axis=1))[:, : start.shape[1]])


def _is_mirrored(samples: npt.NDArray[np.float64]) -> bool:
    size = 2 * len(samples)
    # Correlation with its own reversal is its convolution with itself.
    spectrum = np.fft.rfft(samples, size) ** 2
    likeness = np.abs(np.fft.irfft(spectrum, size)).max() / float(samples @ samples)
    return bool(likeness > MIRROR_LIKENESS)
