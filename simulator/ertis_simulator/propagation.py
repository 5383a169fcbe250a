"""Echoes to pressure at the microphones: one band-limited impulse train for each.

Trains are complex, around the chirp's middle and only as fast as its band is wide (``band``). Every
point's spectrum (power of k, piston pattern, absorption, roughness) is smooth in frequency, so that
its impulse is a short filter (``echo_kernels``). A body's response has any spectrum: it is sampled
in frequency over its own short time. The chirp and the sensor's response are applied once.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.piston import piston_pattern
from ertis_simulator.band import Band
from ertis_simulator.echo_kernels import HALF_BAND, impulse_table, place_echoes
from ertis_simulator.echoes import Echoes, Response
from ertis_simulator.sensor_response import SensorResponse, shipped_response
from ertis_simulator.transducer import AMPLITUDE_AT_1M

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]

_RESPONSE_MARGIN = 20  # samples of a train around a body's response for its band limit to ring
_FADED, _LOWEST = 0.44, 0.015  # of a train's rate: a body's spectrum fades out there, and at 0 Hz


def _way(
    k: FloatArray,
    air: Air,
    frequency_hz: FloatArray,
    echoes: Echoes | Response,
    path_m: FloatArray,
    exponent: FloatArray | float = 0.0,
) -> FloatArray:
    """What emission, air and rough surfaces leave, shape (num_ways, num_frequencies)."""

    def column(values: FloatArray | float) -> FloatArray:
        return np.asarray(values, np.float64).reshape(-1, 1)

    attenuation = air.absorption_db_m(frequency_hz) * (np.log(10) / 20)
    value = column(exponent) * np.log(k) - column(path_m) * attenuation
    value = np.exp(value - column(echoes.roughness_m) ** 2 * (2 * k**2))
    return np.asarray(value * piston_pattern(k, column(echoes.sin_emission)))


def spectra(echoes: Echoes, air: Air, frequency_hz: FloatArray) -> FloatArray:
    """Amplitude of each point over frequency, shape (num_echoes, num_frequencies)."""
    k = 2 * np.pi * frequency_hz / air.speed_of_sound_m_s
    return _way(k, air, frequency_hz, echoes, echoes.path_m.mean(axis=1), echoes.exponent)


def add_echoes(train: ComplexArray, echoes: Echoes, air: Air, band: Band) -> None:
    """Add echoes to trains.

    Parameters
    ----------
    train : complex64, shape (num_mics, band.length), added to
    echoes : Echoes
        For ``num_mics`` microphones.
    air : Air
    band : Band
    """
    speed = air.speed_of_sound_m_s
    if echoes.gain.size:
        delay_s = echoes.path_m / speed
        # What arrives after the frame is not heard; its tail must not wrap to the start either.
        in_frame = delay_s < band.num_samples / (band.rate_hz * band.decimation)
        sampled = spectra(echoes, air, band.nodes_hz)
        place_echoes(
            train,
            delay_s * band.rate_hz,
            np.where(in_frame, AMPLITUDE_AT_1M * echoes.gain, 0.0),
            np.einsum("en,nk->ek", sampled, band.fit).astype(np.float32),
            band.carrier_hz / band.rate_hz,
            impulse_table(),
        )
    for response in echoes.responses:
        _place_response(train, response, air, band)


def _place_response(train: ComplexArray, response: Response, air: Air, band: Band) -> None:
    """Add a body's impulse response to trains."""
    c, rate_hz = air.speed_of_sound_m_s, band.rate_hz
    path_m, (before_m, behind_m) = response.body.path_m, response.body.reach_m
    first = max(int((path_m.min() - before_m) / c * rate_hz) - _RESPONSE_MARGIN, 0)
    last = int((path_m.max() + behind_m) / c * rate_hz) + _RESPONSE_MARGIN
    # What arrives after the frame is not heard; its tail must not wrap to the start either.
    frame_s = band.num_samples / (rate_hz * band.decimation)
    if path_m.min() / c > frame_s or last >= train.shape[1]:
        return
    size = scipy.fft.next_fast_len(last - first)
    edge = int(min(_FADED, band.carrier_hz / rate_hz - _LOWEST) * size)
    wanted = np.arange(-edge, edge + 1)  # counted from the carrier
    found = _response_spectrum(response, air, band, wanted / size, first)
    # Trains count their samples' phase from the start of the frame.
    found *= np.complex64(np.exp(-2j * np.pi * band.carrier_hz * first / rate_hz))
    spectrum = np.zeros((path_m.size, size), np.complex64)
    spectrum[:, : edge + 1], spectrum[:, -edge:] = found[:, edge:], found[:, :edge]
    heard = scipy.fft.ifft(spectrum, axis=1, overwrite_x=True)
    train[:, first : first + size] += heard[:, : train.shape[1] - first]


def _response_spectrum(
    response: Response, air: Air, band: Band, turns: FloatArray, first: int
) -> ComplexArray:
    """What a body returns by its way, delays counted from the train's ``first`` sample.

    turns : shape (num_frequencies,)
        From the carrier, a sample. Faded beyond the band: a sharp edge in frequency would ring
        beyond the samples kept.
    """
    speed, body = air.speed_of_sound_m_s, response.body
    frequency_hz = band.carrier_hz + turns * band.rate_hz
    k = 2 * np.pi * frequency_hz / speed
    way = _way(k, air, frequency_hz, response, np.array([body.path_m.mean()]))
    beyond = np.clip((turns[-1] - np.abs(turns)) / (turns[-1] - HALF_BAND), 0, 1)
    way *= response.factor * AMPLITUDE_AT_1M * np.sin(np.pi / 2 * beyond) ** 2
    from_m = np.full(body.path_m.size, first / band.rate_hz * speed)
    return np.asarray(body.spectrum(k, from_m) * way.astype(np.float32))


def add_trains(
    spectrum: ComplexArray, train: ComplexArray, mic_response: ComplexArray, band: Band
) -> None:
    """Add what trains sound like to spectra.

    Parameters
    ----------
    spectrum : complex64, shape (num_mics, band.fft_size // 2 + 1), added to
    train : complex64, shape (num_mics, band.length)
    mic_response : complex64, shape (num_mics,)
    band : Band
    """
    heard, bins = scipy.fft.fft(train, axis=1), band.bins
    half, first = bins.size // 2, int(bins[0])
    # Trains run at a fraction of the rate, so their spectrum is that fraction as large.
    emitted = band.emitted
    weights = mic_response[:, None].astype(np.complex64)
    spectrum[:, first : first + half] += heard[:, -half:] * emitted[:half] * weights
    spectrum[:, first + half : first + bins.size] += heard[:, : half + 1] * emitted[half:] * weights


def render(
    echoes: Echoes,
    air: Air,
    chirp: FloatArray,
    num_samples: int,
    mic_response: ComplexArray,
    sensor: SensorResponse | None = None,
) -> npt.NDArray[np.float32]:
    """Pressure at the microphones, full scale 1, without noise.

    Parameters
    ----------
    echoes : Echoes
        For ``num_mics`` microphones.
    air : Air
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    num_samples : int
        Audio samples wanted.
    mic_response : complex64, shape (num_mics,)
    sensor : SensorResponse, optional
        Of transducer and microphones; the shipped one unless given.

    Returns
    -------
    float32, shape (num_mics, num_samples)
    """
    band = Band.of(chirp, num_samples, sensor or shipped_response())
    train = np.zeros((len(mic_response), band.length), np.complex64)
    add_echoes(train, echoes, air, band)
    spectrum = np.zeros((len(mic_response), band.fft_size // 2 + 1), np.complex64)
    add_trains(spectrum, train, mic_response, band)
    return np.asarray(scipy.fft.irfft(spectrum, band.fft_size, axis=1)[:, :num_samples])
