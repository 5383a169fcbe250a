"""What a frame tells: the same measurements for a simulated ping and a real one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.signal

from ertis_detector.air import Air
from ertis_driver.frame import AUDIO_RATE_HZ, NUM_MICS, PDM_RATE_HZ

FloatArray = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint32]

_FFT = 32_768
FREQUENCY_HZ: FloatArray = scipy.fft.rfftfreq(_FFT, 1 / AUDIO_RATE_HZ)
SOUND_BAND_HZ = (20e3, 60e3)  # what a 25-50 kHz chirp fills


def bits(words: Words) -> npt.NDArray[np.float32]:
    """PDM words as +-1, shape (32, num_words)."""
    octets = words.astype("<u4").view(np.uint8).reshape(-1, 4)
    flat = np.unpackbits(octets, axis=1, bitorder="little").T
    return np.asarray(2 * flat.astype(np.float32) - 1)


def density(words: Words, size: int = 2048) -> tuple[FloatArray, FloatArray]:
    """Power density of the bits: Hz, shape (n,); median of the microphones, dBFS/Hz, shape (n,)."""
    frequency_hz, power = scipy.signal.welch(
        bits(words), PDM_RATE_HZ, window=("kaiser", 10.0), nperseg=size, axis=1
    )
    return frequency_hz, 10 * np.log10(np.median(power, axis=0))


def in_bands(
    frequency_hz: FloatArray, level_db: FloatArray, centres_hz: FloatArray, width: float = 0.06
) -> FloatArray:
    """Mean density around each centre, dB; ``width`` in parts of it, 3 kHz at least."""
    reach_hz = np.maximum(centres_hz * width / 2, 3e3)
    near = np.abs(frequency_hz[None] - centres_hz[:, None]) <= reach_hz[:, None]
    power = np.where(near, 10 ** (level_db / 10)[None], 0.0).sum(axis=1) / near.sum(axis=1)
    return np.asarray(10 * np.log10(power))


def level_over_time(
    audio: npt.NDArray[np.float32], starts_s: FloatArray, width_s: float = 0.25e-3
) -> FloatArray:
    """Level from 20 to 60 kHz after each start, dBFS (RMS), shape (32, num_starts)."""
    part = np.array(audio[:, : _FFT // 2], np.float64)
    part[:, :12] = 0.0  # start-up
    spectrum = scipy.fft.rfft(part, _FFT, axis=1)
    spectrum[:, (SOUND_BAND_HZ[0] > FREQUENCY_HZ) | (SOUND_BAND_HZ[1] < FREQUENCY_HZ)] = 0.0
    power = scipy.fft.irfft(spectrum, _FFT, axis=1)[:, : part.shape[1]] ** 2
    total = np.concatenate([np.zeros((NUM_MICS, 1)), np.cumsum(power, axis=1)], axis=1)
    first = np.rint(starts_s * AUDIO_RATE_HZ).astype(int)
    width = round(width_s * AUDIO_RATE_HZ)
    mean = (total[:, first + width] - total[:, first]) / width
    return np.asarray(10 * np.log10(np.maximum(mean, 1e-16)))


def run_shares(words: Words, longest: int = 4) -> FloatArray:
    """Share of runs of 1, 2, ... ``longest`` or more equal bits in all runs, shape (longest,)."""
    counts = np.zeros(longest)
    for row in bits(words):
        runs = np.diff(np.flatnonzero(np.diff(row)))
        counts += np.bincount(np.minimum(runs, longest), minlength=longest + 1)[1:]
    return np.asarray(counts / counts.sum())


def aligned(
    audio: npt.NDArray[np.float32], chirp: FloatArray, path_m: FloatArray, air: Air
) -> npt.NDArray[np.complex128]:
    """Spectra times the chirp's conjugate, turned back by each path: shape (32, frequencies)."""
    spectrum = scipy.fft.rfft(np.asarray(audio, np.float64), _FFT, axis=1)
    turn = np.exp(2j * np.pi * FREQUENCY_HZ * path_m[:, None] / air.speed_of_sound_m_s)
    return np.asarray(spectrum * turn * np.conj(scipy.fft.rfft(chirp, _FFT)))


def echo_shape(
    audio: npt.NDArray[np.float32],
    chirp: FloatArray,
    path_m: FloatArray,
    air: Air,
    centres_hz: FloatArray,
    gate_s: float = 0.25e-3,
) -> FloatArray:
    """Transfer function of one echo, absorption taken out, dB, shape (num_centres,).

    Compressed, gated around the path, divided by the chirp compressed and gated likewise; powers of
    the microphones averaged.
    """
    own = np.abs(scipy.fft.rfft(chirp, _FFT)) ** 2 + 0j
    heard = np.mean(np.abs(_gated(aligned(audio, chirp, path_m, air), gate_s)) ** 2, axis=0)
    ratio = heard / np.abs(_gated(own, gate_s)) ** 2
    near = np.abs(FREQUENCY_HZ[None] - centres_hz[:, None]) < 700.0
    level = 10 * np.log10(np.where(near, ratio[None], 0).sum(axis=1) / near.sum(axis=1))
    return np.asarray(level + air.absorption_db_m(centres_hz) * path_m.mean())


def _gated(
    spectrum: npt.NDArray[np.complex128], gate_s: float, flat: float = 0.0
) -> npt.NDArray[np.complex128]:
    """Keep what lies around zero delay; that part of the gate is flat, the rest tapers."""
    half = round(gate_s * AUDIO_RATE_HZ)
    window, taper = np.zeros(_FFT), scipy.signal.windows.tukey(2 * half, 1 - flat)
    window[:half], window[-half:] = taper[half:], taper[:half]
    return np.asarray(scipy.fft.rfft(scipy.fft.irfft(spectrum, _FFT) * window))


def group_delay(
    audio: npt.NDArray[np.float32],
    chirp: FloatArray,
    path_m: FloatArray,
    air: Air,
    band_hz: tuple[float, float],
    gate_s: float = 0.4e-3,
) -> float:
    """By how much one echo's band comes later than its path, s; louder frequencies count more."""
    band = (band_hz[0] < FREQUENCY_HZ) & (band_hz[1] > FREQUENCY_HZ)
    # A taper over all of the gate would draw what is late toward its middle.
    heard = _gated(aligned(audio, chirp, path_m, air), gate_s, flat=0.75)[:, band]
    turn = np.sum(heard[:, 1:] * np.conj(heard[:, :-1]))
    return float(-np.angle(turn) / (2 * np.pi * FREQUENCY_HZ[1]))


def echo_gains(
    audio: npt.NDArray[np.float32],
    chirp: FloatArray,
    path_m: FloatArray,
    air: Air,
    positions_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Level (dB) and phase (degrees) of one echo at each microphone, shape (32,) each.

    Their means, and from the phase the plane that a small error of bearing leaves, are taken out.
    """
    band = (FREQUENCY_HZ > 25e3) & (FREQUENCY_HZ < 52e3)
    each = aligned(audio, chirp, path_m, air)[:, band].sum(axis=1)
    level = 20 * np.log10(np.abs(each))
    phase = np.angle(each * np.conj(each.sum()))
    plane = np.column_stack([np.ones(NUM_MICS), positions_m[:, 1:]])
    phase = phase - plane @ np.linalg.lstsq(plane, phase, rcond=None)[0]
    return level - level.mean(), np.rad2deg(phase)


def likeness(audio: npt.NDArray[np.float32], low_hz: float, high_hz: float) -> float:
    """Largest eigenvalue of the microphones' normalised covariance in a band; 32 if all are one."""
    sos = scipy.signal.butter(6, (low_hz, high_hz), "bandpass", fs=AUDIO_RATE_HZ, output="sos")
    tail = scipy.signal.sosfilt(sos, np.asarray(audio[:, -4_000:], np.float64), axis=1)
    return float(np.linalg.eigvalsh(np.corrcoef(tail[:, 500:]))[-1])
