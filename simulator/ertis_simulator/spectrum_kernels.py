"""What is added to the microphones' spectra, a bin at a time: noise, and plane waves."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

BYTES_VARIANCE = 4 * (256**2 - 1) / 12  # of the sum of four random bytes
_BYTES_MEAN = 2 * 255
_LANES = 8


@numba.njit(cache=True, nogil=True)
def add_shaped_noise(
    spectrum: npt.NDArray[np.complex64],
    random: npt.NDArray[np.uint32],
    scale: npt.NDArray[np.float32],
) -> None:
    """Add noise to spectra.

    The parts of a bin are sums of four random bytes. A sample is a sum over all bins: Gaussian,
    whatever a bin's distribution is.

    spectrum : complex64, shape (num_mics, num_bins)
    random : uint32, shape (num_mics, 2 * num_bins)
    scale : float32, shape (num_bins,), of a byte's unit
    """
    parts = spectrum.view(np.float32)
    mean = np.int32(_BYTES_MEAN)
    for mic in range(spectrum.shape[0]):
        for n in range(2 * spectrum.shape[1]):
            word = random[mic, n]
            low = (word & np.uint32(0xFF)) + ((word >> np.uint32(8)) & np.uint32(0xFF))
            high = ((word >> np.uint32(16)) & np.uint32(0xFF)) + (word >> np.uint32(24))
            parts[mic, n] += np.float32(np.int32(low + high) - mean) * scale[n >> 1]


@numba.njit(cache=True, nogil=True)
def add_plane_wave(
    spectrum: npt.NDArray[np.complex64],
    wave: npt.NDArray[np.complex64],
    turn_a_bin: npt.NDArray[np.float64],
) -> None:
    """Add one waveform to spectra, earlier or later at each microphone.

    spectrum : complex64, shape (num_mics, num_bins)
    wave : complex64, shape (num_bins,), its spectrum
    turn_a_bin : float64, shape (num_mics,), phase from bin to bin, + for earlier
    """
    size = spectrum.shape[1]
    c, s = np.empty(_LANES), np.empty(_LANES)
    cosine, sine = np.empty(size + _LANES, np.float32), np.empty(size + _LANES, np.float32)
    real, imag = np.empty(size, np.float32), np.empty(size, np.float32)
    for n in range(size):
        real[n], imag[n] = wave[n].real, wave[n].imag
    parts = spectrum.view(np.float32)
    for mic in range(spectrum.shape[0]):
        for lane in range(_LANES):
            phase = lane * turn_a_bin[mic]
            c[lane], s[lane] = np.cos(phase), np.sin(phase)
        phase = _LANES * turn_a_bin[mic]
        step_c, step_s = np.cos(phase), np.sin(phase)
        for start in range(0, size, _LANES):
            for lane in range(_LANES):
                x, y = c[lane], s[lane]
                cosine[start + lane], sine[start + lane] = np.float32(x), np.float32(y)
                c[lane], s[lane] = x * step_c - y * step_s, x * step_s + y * step_c
        out = parts[mic]
        for n in range(size):
            out[2 * n] += real[n] * cosine[n] - imag[n] * sine[n]
            out[2 * n + 1] += real[n] * sine[n] + imag[n] * cosine[n]
