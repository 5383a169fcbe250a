"""What a user would write: plain NumPy and SciPy, as the sensor's own documentation has it."""

from __future__ import annotations

import numpy as np
import scipy.signal

PDM_RATE_HZ, AUDIO_RATE_HZ = 4.5e6, 450e3
_LOW_PASS = scipy.signal.butter(6, 100e3, "lowpass", fs=PDM_RATE_HZ, output="sos")


def bits_of(words: np.ndarray) -> np.ndarray:
    """Bits as +-1, uint32 (n,) to float64 (32, n)."""
    bits = np.unpackbits(words.view(np.uint8).reshape(-1, 4), axis=1, bitorder="little")
    return 2.0 * bits.T - 1.0


def decimate(words: np.ndarray) -> np.ndarray:
    """Low-pass at the PDM rate, then every tenth sample; float64 (32, n / 10)."""
    return scipy.signal.sosfilt(_LOW_PASS, bits_of(words), axis=1)[:, ::10]


class UserScript:
    """Words to an image in the horizontal plane.

    Parameters
    ----------
    chirp : float64, shape (n,)
    band_hz : (low, high)
    mics_m : float64, shape (32, 3)
    azimuth_rad : float64, shape (num_directions,)
    speed_m_s : float
    """

    def __init__(
        self,
        chirp: np.ndarray,
        band_hz: tuple[float, float],
        mics_m: np.ndarray,
        azimuth_rad: np.ndarray,
        speed_m_s: float,
    ) -> None:
        self._chirp = chirp
        self._band = scipy.signal.butter(4, band_hz, "bandpass", fs=AUDIO_RATE_HZ, output="sos")
        toward = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), 0 * azimuth_rad], axis=1)
        late_s = -toward @ mics_m.T / speed_m_s
        self._delays = np.rint((late_s - late_s.min()) * AUDIO_RATE_HZ).astype(int)
        self._margin = int(self._delays.max())
        # 0.5 to 5 m, as the energyscape's goal is stated.
        ends = 2 * np.array([0.5, 5.0]) / speed_m_s * AUDIO_RATE_HZ
        self._first, self._last = (int(end) for end in ends)

    def audio(self, words: np.ndarray) -> np.ndarray:
        """Decimated and band-passed; float64 (32, n / 10)."""
        return scipy.signal.sosfilt(self._band, decimate(words), axis=1)

    def image(self, audio: np.ndarray) -> np.ndarray:
        """Matched filter, integer delays, sum, envelope; shape (num_directions, num_ranges)."""
        matched = scipy.signal.fftconvolve(audio, self._chirp[None, ::-1], axes=1)
        matched = matched[:, self._chirp.size - 1 :]
        rows = []
        for delays in self._delays:
            total = np.zeros(self._last - self._first)
            for mic, delay in enumerate(delays):
                total += matched[mic, self._first + delay : self._last + delay]
            rows.append(np.abs(scipy.signal.hilbert(total))[::16])
        return np.array(rows)
