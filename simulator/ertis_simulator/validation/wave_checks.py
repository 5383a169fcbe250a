"""Geometry through the renderer: spreading, absorption, beam pattern, delays, level."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_detector.piston import PISTON_RADIUS_M
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.microphone import to_pdm
from ertis_simulator.propagation import render
from ertis_simulator.sensor_response import shipped_response
from ertis_simulator.transducer import AMPLITUDE_AT_1M
from ertis_simulator.validation.check import Check

FloatArray = npt.NDArray[np.float64]
AIR = Air(20.0, 50.0)
RANGES_M = (0.6, 0.85, 1.2, 1.7, 2.4, 3.4, 4.8, 6.0)
_SAMPLES, _FFT = 18_000, 32_768  # the whole chirp from 6 m
_FREQUENCY_HZ: FloatArray = np.asarray(np.fft.rfftfreq(_FFT, 1 / AUDIO_RATE_HZ), np.float64)
_FIRST_NULL = 3.8317  # of J1


def _transfer(echoes: Echoes) -> npt.NDArray[np.complex128]:
    """Rendered over emitted: the chain's transfer function, shape (num_mics, num_frequencies)."""
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    ideal = np.ones(echoes.path_m.shape[1], np.complex64)
    heard = render(echoes, AIR, chirp, _SAMPLES, ideal)
    emitted = np.fft.rfft(chirp, _FFT) * shipped_response().amplitude(_FREQUENCY_HZ)
    emitted *= AMPLITUDE_AT_1M
    return np.asarray(np.fft.rfft(heard, _FFT, axis=1) / emitted)


def _at(transfer: npt.NDArray[np.complex128], frequency_hz: float) -> float:
    """Level around a frequency, dB."""
    near = np.abs(_FREQUENCY_HZ - frequency_hz) < 300.0
    return float(10 * np.log10(np.mean(np.abs(transfer[:, near]) ** 2)))


def levels_over_range(frequency_hz: float) -> FloatArray:
    """Level of a point scatterer of 1 m at ``RANGES_M``, dB, with absorption taken out."""
    absorbed = float(AIR.absorption_db_m(np.array(frequency_hz)))
    levels = [
        _at(_transfer(Echoes.of(np.full(1, 2 * r), np.full(1, r**-2))), frequency_hz)
        + absorbed * 2 * r
        for r in RANGES_M
    ]
    return np.array(levels)


def piston_by_quadrature(wavenumber: float, sine: float, points: int = 400) -> float:
    """Far field of a disc by adding up its face in strips: independent of any Bessel function."""
    y = (np.arange(points) + 0.5) / points * 2 - 1
    strip = np.sqrt(1 - y**2)
    phase = wavenumber * PISTON_RADIUS_M * sine * y
    return float(np.sum(strip * np.cos(phase)) / np.sum(strip))


def beam_pattern(frequency_hz: float, degrees: FloatArray) -> FloatArray:
    """Rendered level over the angle of emission against that on the axis, dB."""
    path = np.full((1, 1), 4.0)
    sines = np.sin(np.deg2rad(degrees))
    levels = [_at(_transfer(Echoes.of(path, path, sin_emission=s)), frequency_hz) for s in sines]
    return np.array(levels) - _at(_transfer(Echoes.of(path, path)), frequency_hz)


def delay_errors_s(*, through_pdm: bool) -> FloatArray:
    """Delay of 32 microphones against geometry for a point up, left and 2 m away; s."""
    point = 2.0 * np.array([0.85, 0.5, 0.17])
    mics, emitter = mic_positions_m(), np.array(EMITTER_POSITION_M)
    path = np.sqrt(((point - emitter) ** 2).sum()) + np.sqrt(((point - mics) ** 2).sum(axis=1))
    echo = Echoes.of(path, np.full(32, 0.4 if through_pdm else 1.0))
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    heard = render(echo, AIR, chirp, _SAMPLES, np.ones(32, np.complex64))
    if through_pdm:
        heard = PdmDecoder().decode(to_pdm(heard, np.random.default_rng(0))).audio
    band = (_FREQUENCY_HZ > 40e3) & (_FREQUENCY_HZ < 65e3)
    cross = np.fft.rfft(heard, _FFT, axis=1) * np.conj(np.fft.rfft(chirp, _FFT))
    turned = cross[:, band] * np.exp(
        2j * np.pi * _FREQUENCY_HZ[band] * path[:, None] / AIR.speed_of_sound_m_s
    )
    # Phase delay at the band's centre of gravity: what is left of the turn.
    weight = np.abs(turned) ** 2
    centre_hz = np.sum(weight * _FREQUENCY_HZ[band], axis=1) / np.sum(weight, axis=1)
    return np.asarray(-np.angle(turned.sum(axis=1)) / (2 * np.pi * centre_hz))


def level_error_db() -> float:
    """Level of an echo through renderer, modulator and decimation, against what was emitted."""
    path, gain = np.full(32, 3.0), np.full(32, 0.3)
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    heard = render(Echoes.of(path, gain), AIR, chirp, _SAMPLES, np.ones(32, np.complex64))
    audio = PdmDecoder().decode(to_pdm(heard, np.random.default_rng(1))).audio
    band = (_FREQUENCY_HZ > 30e3) & (_FREQUENCY_HZ < 70e3)
    frequency_hz = _FREQUENCY_HZ[band]
    expected = np.fft.rfft(chirp, _FFT)[band] * shipped_response().amplitude(frequency_hz)
    expected = expected * AMPLITUDE_AT_1M * 0.3
    expected = expected * 10 ** (-AIR.absorption_db_m(frequency_hz) * 3.0 / 20)
    power = np.mean(np.abs(np.fft.rfft(audio, _FFT, axis=1)[:, band]) ** 2, axis=0)
    return float(10 * np.log10(power.sum() / np.sum(np.abs(expected) ** 2)))


def checks() -> list[Check]:
    """All of it."""
    rows = []
    for frequency_hz in (30e3, 50e3, 75e3):
        levels = levels_over_range(frequency_hz)
        slope = np.polyfit(np.log2(RANGES_M), levels, 1)[0]
        name = f"{frequency_hz / 1e3:.0f} kHz"
        rows.append(
            Check(
                f"spreading per doubling of range, 0.6 to 6 m, {name}",
                "1/r there and back, less ISO 9613-1",
                -40 * np.log10(2),
                float(slope),
                0.05,
                "dB",
            )
        )
    for frequency_hz in (30e3, 50e3, 75e3):
        degrees = np.array([5.0, 10.0, 15.0, 25.0, 40.0])
        wavenumber = 2 * np.pi * frequency_hz / AIR.speed_of_sound_m_s
        exact = np.array([piston_by_quadrature(wavenumber, s) for s in np.sin(np.deg2rad(degrees))])
        off = 10 ** (beam_pattern(frequency_hz, degrees) / 20) - np.abs(exact)
        rows.append(
            Check(
                f"beam pattern, {frequency_hz / 1e3:.0f} kHz, worst of 5 angles to 40 degrees",
                "disc added up in strips, far field",
                0.0,
                float(np.abs(off).max()),
                0.02,
                "of the axis",
            )
        )
    degrees = np.arange(15.0, 23.0, 0.1)
    null = degrees[beam_pattern(50e3, degrees).argmin()]
    wavenumber = 2 * np.pi * 50e3 / AIR.speed_of_sound_m_s
    expected = np.rad2deg(np.arcsin(_FIRST_NULL / (wavenumber * PISTON_RADIUS_M)))
    rows.append(
        Check("first null, 50 kHz", "2 J1(x)/x, x = 3.8317", float(expected), null, 0.2, "degrees")
    )
    rendered, decoded = delay_errors_s(through_pdm=False), delay_errors_s(through_pdm=True)
    rows += [
        Check(
            "delays of 32 microphones, worst, rendered",
            "distances, 343.9 m/s",
            0.0,
            float(np.abs(rendered).max() * 1e9),
            20.0,
            "ns",
        ),
        Check(
            "the same through modulator and decimation: mean",
            "one PDM word early, by construction",
            -1e9 / 4.5e6,
            float(decoded.mean() * 1e9),
            30.0,
            "ns",
        ),
        Check(
            "the same: worst against that mean",
            "exact geometry",
            0.0,
            float(np.abs(decoded - decoded.mean()).max() * 1e9),
            30.0,
            "ns",
        ),
        Check(
            "level of an echo, end to end, 30 to 70 kHz",
            "emission, 1/r, absorption",
            0.0,
            level_error_db(),
            0.15,
            "dB",
        ),
    ]
    return rows
