"""Echoes to pressure at the microphones: one band-limited impulse train per smooth spectrum.

Every echo's spectrum (power of k, piston pattern, absorption, roughness) is smooth in frequency, so
it is a short sum of fixed polynomials. Impulses go into one complex train a polynomial at 150 kHz
around 62.5 kHz; the chirp and the sensor's response are applied once, to their spectra. A body's
response has any spectrum: it is sampled in frequency and goes into the train of the constant.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.piston import piston_pattern
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.echoes import Echoes, Response
from ertis_simulator.kernels import KERNEL_TAPS, place_echoes
from ertis_simulator.transducer import AMPLITUDE_AT_1M, SensorResponse, shipped_response

BAND_HZ = (10e3, 115e3)
_DECIMATION = 3  # 450 to 150 kHz, complex
_CHIRP_ROOM = 2_048  # audio samples behind the frame for the tails of the last echoes
_BASIS = 8
_FRACTIONS = 256
_RESPONSE_MARGIN = 24  # samples of 6.7 us around a body's response for its band limit to ring
_FADE_HZ = (3e3, 125e3)


@cache
def _kernel_table() -> npt.NDArray[np.float32]:
    """Kaiser-windowed sinc at every fractional delay; flat to 90 dB over BAND_HZ."""
    fraction = np.arange(_FRACTIONS + 1)[:, None] / _FRACTIONS
    x = np.arange(KERNEL_TAPS) - (KERNEL_TAPS // 2 - 1) - fraction
    half = KERNEL_TAPS / 2
    window = np.i0(9.0 * np.sqrt(np.clip(1 - (x / half) ** 2, 0, 1))) / np.i0(9.0)
    return np.asarray((np.sinc(x) * window).astype(np.float32))


def _polynomials(frequency_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Chebyshev polynomials over the band, shape (num_frequencies, _BASIS)."""
    low, high = BAND_HZ
    x = (2 * frequency_hz - low - high) / (high - low)
    return np.asarray(np.polynomial.chebyshev.chebvander(x, _BASIS - 1))


def _way(
    k: npt.NDArray[np.float64],
    air: Air,
    frequency_hz: npt.NDArray[np.float64],
    path_m: npt.NDArray[np.float64],
    sin_emission: npt.NDArray[np.float64],
    roughness_m: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]:
    """What emission, air and rough surfaces leave, shape (num_ways, num_frequencies)."""
    attenuation = air.absorption_db_m(frequency_hz) * (np.log(10) / 20)
    value = np.exp(-attenuation[None, :] * path_m[:, None])
    value = value * piston_pattern(k[None, :], sin_emission[:, None])
    return np.asarray(value * np.exp(-2 * (k[None, :] * roughness_m[:, None]) ** 2))


def spectra(
    echoes: Echoes, air: Air, frequency_hz: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Amplitude of each echo over frequency, shape (num_echoes, num_frequencies)."""
    k = 2 * np.pi * frequency_hz / air.speed_of_sound_m_s
    path_m = echoes.path_m.mean(axis=1)
    way = _way(k, air, frequency_hz, path_m, echoes.sin_emission, echoes.roughness_m)
    return np.asarray(way * k[None, :] ** echoes.exponent[:, None])


def _coefficients(
    echoes: Echoes,
    air: Air,
    chirp: npt.NDArray[np.float64],
    sensor: SensorResponse,
    fft_size: int,
) -> npt.NDArray[np.float64]:
    """Polynomials of each echo's spectrum, shape (num_echoes, _BASIS).

    Fitted best where something is emitted and heard: -58 dB there up to 35 degrees off axis, 6 m
    and 1 mm of roughness.
    """
    nodes = np.linspace(*BAND_HZ, 48)
    grid_hz = np.fft.rfftfreq(fft_size, 1 / AUDIO_RATE_HZ)
    emitted = np.abs(scipy.fft.rfft(chirp, fft_size))
    trust = np.interp(nodes, grid_hz, emitted) * sensor.amplitude(nodes)
    trust = np.maximum(trust / max(float(trust.max()), 1e-12), 1e-3)
    inverse = np.linalg.pinv(_polynomials(nodes) * trust[:, None])
    return np.asarray(spectra(echoes, air, nodes) @ (inverse * trust).T)


def _place_response(
    train: npt.NDArray[np.complex64],
    response: Response,
    air: Air,
    carrier_hz: float,
    frame_s: float,
) -> None:
    """Add a body's impulse response to a train of shape (num_mics, length)."""
    c, rate_hz = air.speed_of_sound_m_s, AUDIO_RATE_HZ / _DECIMATION
    path_m, (before_m, behind_m) = response.body.path_m, response.body.reach_m
    first = max(int((path_m.min() - before_m) / c * rate_hz) - _RESPONSE_MARGIN, 0)
    last = int((path_m.max() + behind_m) / c * rate_hz) + _RESPONSE_MARGIN
    # What arrives after the frame is not heard; its tail must not wrap to the start either.
    if path_m.min() / c > frame_s or last >= train.shape[1]:
        return
    size = scipy.fft.next_fast_len(last - first)
    low, high = (round((edge - carrier_hz) * size / rate_hz) for edge in _FADE_HZ)
    wanted = np.arange(low, high + 1)  # counted from the carrier
    frequency_hz = np.asarray(carrier_hz + wanted * (rate_hz / size), np.float64)
    spectrum = np.zeros((path_m.size, size), np.complex64)
    spectrum[:, wanted] = _response_spectrum(response, air, frequency_hz, first / rate_hz)
    # Trains count their samples' phase from the start of the frame.
    spectrum *= np.exp(-2j * np.pi * carrier_hz * first / rate_hz)
    train[:, first : first + size] += scipy.fft.ifft(spectrum, axis=1)[:, : train.shape[1] - first]


def _response_spectrum(
    response: Response, air: Air, frequency_hz: npt.NDArray[np.float64], start_s: float
) -> npt.NDArray[np.complex64]:
    """What a body returns by its way, delays counted from ``start_s``; faded beyond the band."""
    path_m = response.body.path_m
    k = np.asarray(2 * np.pi * frequency_hz / air.speed_of_sound_m_s)
    mean_m, sine, roughness_m = (
        np.array([value]) for value in (path_m.mean(), response.sin_emission, response.roughness_m)
    )
    way = _way(k, air, frequency_hz, mean_m, sine, roughness_m)
    # A sharp edge in frequency would ring beyond the samples kept.
    fade = np.interp(frequency_hz, (_FADE_HZ[0], *BAND_HZ, _FADE_HZ[1]), (0, 1, 1, 0))
    way = way * (response.factor * AMPLITUDE_AT_1M * np.sin(np.pi / 2 * fade) ** 2)
    late_m = path_m[:, None] - start_s * air.speed_of_sound_m_s
    return np.asarray(response.body.spectrum(k) * np.exp(-1j * k * late_m) * way, np.complex64)


def render(
    echoes: Echoes,
    air: Air,
    chirp: npt.NDArray[np.float64],
    num_samples: int,
    mic_response: npt.NDArray[np.complex64],
    sensor: SensorResponse | None = None,
) -> npt.NDArray[np.float32]:
    """Pressure at the microphones, full scale 1, without noise.

    Parameters
    ----------
    echoes : Echoes
        For ``num_mics`` microphones.
    air : Air
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz, up to 2048 samples are free of wrap-around.
    num_samples : int
        Audio samples wanted.
    mic_response : complex64, shape (num_mics,)
    sensor : SensorResponse, optional
        Of transducer and microphones; the shipped one unless given.

    Returns
    -------
    float32, shape (num_mics, num_samples)
    """
    room = max(_CHIRP_ROOM, chirp.size + 64)
    length = -(-(num_samples + room) // (_DECIMATION * 256)) * 256
    fft_size = length * _DECIMATION
    spacing = AUDIO_RATE_HZ / fft_size
    carrier_bin = round(sum(BAND_HZ) / 2 / spacing)
    carrier_hz = carrier_bin * spacing

    sensor = sensor or shipped_response()
    coefficients = _coefficients(echoes, air, chirp, sensor, fft_size)
    delay_s = echoes.path_m / air.speed_of_sound_m_s
    # What arrives after the frame is not heard; its tail must not wrap to the start either.
    gain = np.where(delay_s < num_samples / AUDIO_RATE_HZ, echoes.gain, 0.0)
    turn = np.exp(-2j * np.pi * carrier_hz * delay_s) * (AMPLITUDE_AT_1M * gain)
    weights = (turn[:, :, None] * coefficients[:, None, :]).astype(np.complex64)
    num_mics = echoes.path_m.shape[1]
    trains = np.zeros((num_mics, _BASIS, length), np.complex64)
    place_echoes(trains, delay_s * (AUDIO_RATE_HZ / _DECIMATION), weights, _kernel_table())
    for response in echoes.responses:
        frame_s = num_samples / AUDIO_RATE_HZ
        _place_response(trains[:, 0], response, air, carrier_hz, frame_s)

    first = int(np.ceil(BAND_HZ[0] / spacing))
    bins = np.arange(first, int(BAND_HZ[1] / spacing) + 1)
    frequency_hz = np.asarray(bins * spacing, np.float64)
    heard = scipy.fft.fft(trains, axis=2)[:, :, bins - carrier_bin]
    emitted = scipy.fft.rfft(chirp, fft_size)[bins] * sensor.amplitude(frequency_hz)
    shape = (_polynomials(frequency_hz) * emitted[:, None]).astype(np.complex64)
    # The trains run at a third of the rate, so their spectrum is a third as large.
    band = np.einsum("mkf,fk->mf", heard, shape) * mic_response[:, None]
    spectrum = np.zeros((num_mics, fft_size // 2 + 1), np.complex64)
    spectrum[:, bins] = band
    return np.asarray(scipy.fft.irfft(spectrum, fft_size, axis=1)[:, :num_samples])
