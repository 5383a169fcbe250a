"""The modulator: noise floor, shaping, idle tones, overload, against data sheet and real ping."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

from ertis_driver.audio import PdmDecoder
from ertis_driver.frame import AUDIO_RATE_HZ, NUM_MICS
from ertis_simulator.microphone import add_noise, to_pdm
from ertis_simulator.validation.check import Check
from ertis_simulator.validation.measure import density, in_bands

FloatArray = npt.NDArray[np.float64]
DATA_SHEET = "SPH0641LU4H-1 data sheet: -26 dBFS at 94 dB SPL, 64 dB(A)"
SENSITIVITY_DBFS, SNR_DB = -26.0, 64.0
REAL = "one real ping"
_SAMPLES = 16_384
_LIMIT_DB = 1.0


@cache
def silence() -> npt.NDArray[np.uint32]:
    """Words of 32 simulated microphones in a silent room."""
    rng = np.random.default_rng(20)
    pressure = np.zeros((NUM_MICS, _SAMPLES), np.float32)
    add_noise(pressure, rng)
    words = to_pdm(pressure, rng)
    words.setflags(write=False)
    return words


def a_weighted_bandwidth_db() -> float:
    """Of white noise up to 20 kHz, dB re 1 Hz (IEC 61672-1, annex E)."""
    frequency_hz = np.arange(1.0, 20_000.0)
    f2 = frequency_hz**2
    gain = 12194.0**2 * f2**2 / ((f2 + 20.6**2) * (f2 + 12194.0**2))
    gain /= np.sqrt((f2 + 107.7**2) * (f2 + 737.9**2))
    gain *= 10 ** (2.0 / 20)
    return float(10 * np.log10(np.sum(gain**2)))


def data_sheet_density_db() -> float:
    """The data sheet's noise as a density, dB re an RMS of 1, per Hz; a full sine is -3 dB."""
    return SENSITIVITY_DBFS - SNR_DB - 3.01 - a_weighted_bandwidth_db()


def idle_line_db() -> tuple[float, float]:
    """Strongest spectral line from 20 to 100 kHz over the mean around it: simulated, and Gaussian.

    The second is what chance makes of as many values of plain noise.
    """
    audio = PdmDecoder().decode(silence()).audio[:, 200:]
    noise = np.random.default_rng(21).standard_normal(audio.shape)
    return _strongest_line(audio), _strongest_line(noise)


def _strongest_line(audio: npt.NDArray[np.floating]) -> float:
    spectrum = np.abs(np.fft.rfft(audio * np.hanning(audio.shape[1]), axis=1)) ** 2
    around = np.apply_along_axis(np.convolve, 1, spectrum, np.ones(201) / 201, "same")
    spacing_hz = AUDIO_RATE_HZ / audio.shape[1]
    band = slice(int(20e3 / spacing_hz), int(100e3 / spacing_hz))
    return float(10 * np.log10((spectrum / around)[:, band].max()))


def tone_noise_db(amplitude: float) -> float:
    """Density from 50 to 100 kHz beside a tone of 40 kHz, dBFS/Hz."""
    time_s = np.arange(_SAMPLES) / AUDIO_RATE_HZ
    starts = np.linspace(0, 6, NUM_MICS)[:, None]
    tone = (amplitude * np.sin(2 * np.pi * 40e3 * time_s + starts)).astype(np.float32)
    rng = np.random.default_rng(22)
    add_noise(tone, rng)
    frequency_hz, level_db = density(to_pdm(tone, rng)[5_000:])
    band = (frequency_hz > 50e3) & (frequency_hz < 100e3)
    return float(10 * np.log10(np.mean(10 ** (level_db[band] / 10))))


def recovery_s(over: float = 1.8) -> float:
    """From the end of a burst beyond full scale until the level is 1 dB above silence's, s.

    Mean power of the microphones over 22 us.
    """
    first, last = 2_000, 2_450
    rng = np.random.default_rng(23)
    pressure = np.zeros((NUM_MICS, 6_000), np.float32)
    add_noise(pressure, rng)
    time_s = np.arange(last - first) / AUDIO_RATE_HZ
    pressure[:, first:last] += (over * np.sin(2 * np.pi * 40e3 * time_s)).astype(np.float32)
    audio = PdmDecoder().decode(to_pdm(pressure, rng)).audio
    power = np.convolve((audio**2).mean(axis=0), np.ones(10) / 10, "valid")
    limit = power[200 : first - 100].mean() * 10 ** (_LIMIT_DB / 10)
    return float((power[last:] < limit).argmax() / AUDIO_RATE_HZ)


def checks() -> list[Check]:
    """All of it."""
    frequency_hz, level_db = density(silence()[5_000:])

    def at(*centres_hz: float) -> FloatArray:
        return in_bands(frequency_hz, level_db, np.array(centres_hz))

    fine_hz, fine_db = density(silence()[5_000:], 16_384)
    audible = in_bands(fine_hz, fine_db, np.array([7e3]))[0]
    low, high = at(120e3, 250e3)
    line, chance = idle_line_db()
    return [
        Check(
            "noise at 7 kHz", DATA_SHEET, data_sheet_density_db(), float(audible), 4.0, "dBFS/Hz"
        ),
        Check(
            "noise at 60, 75, 90 and 105 kHz, mean in dB",
            REAL + ", its last 3 ms (-99 to -104 over the whole of it)",
            -106.2,
            float(at(60e3, 75e3, 90e3, 105e3).mean()),
            2.5,
            "dBFS/Hz",
        ),
        Check(
            "shaping from 120 to 250 kHz",
            REAL + ": 75",
            75.0,
            float((high - low) / np.log10(250 / 120)),
            8.0,
            "dB/decade",
        ),
        Check("strongest idle line, 20 to 100 kHz", "plain noise", chance, line, 3.0, "dB"),
        Check(
            "noise beside a tone of half of full scale, against silence",
            REAL + ": none up to full scale",
            0.0,
            tone_noise_db(0.5) - tone_noise_db(0.01),
            1.0,
            "dB",
        ),
        Check(
            "recovery after 5 dB of overload",
            "design: within 0.1 ms",
            0.0,
            recovery_s() * 1e6,
            100.0,
            "us",
        ),
    ]
