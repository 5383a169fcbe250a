"""Echoes of dishes against interference, as the best receiver would weigh them.

Interference is Gaussian and stationary over a fragment: many small reflectors at the fragment's
range in all directions, with the chirp's own spectrum, and a little white noise of the
microphones. Its covariance is known, so that it can be whitened; whatever then happens is between
echoes of unit noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_detector.piston import piston_pattern
from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.landmark import Dish, dish_echoes
from ertis_simulator.sensor_response import shipped_response
from ertis_simulator.truth import FRAGMENT_SAMPLES

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

FRAGMENT_S = FRAGMENT_SAMPLES / AUDIO_RATE_HZ
NOISE_DB = -20.0  # of white noise against clutter, after compression: ASSUMED
# Where clutter stands, all directions as likely: ASSUMED.
_AROUND_RAD = np.arcsin(np.linspace(-0.87, 0.87, 61))
_ABOVE_RAD = np.deg2rad([-20.0, -10.0, 0.0, 10.0, 20.0])


@dataclass(frozen=True, slots=True)
class Place:
    """Where a dish stands, seen from the array; tilt is about the vertical, + to either side."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float = 0.0


@dataclass(frozen=True)
class Receiver:
    """The sonar, and what is known of its interference around one place.

    chirp : Chirp
    place : Place
        Of the dish; the beam looks there.
    one_beam : bool
        Only the sum of all microphones toward the place is given, and the ratio is that inside
        the beam; else all 32 microphones, and the ratio is that at one of them.
    """

    chirp: Chirp
    place: Place
    one_beam: bool
    air: Air = field(default_factory=Air)

    @cached_property
    def frequency_hz(self) -> Float:
        """As far apart as a fragment tells apart: noise there is independent."""
        low, high = self.chirp.band_hz
        first = int(np.ceil(low * FRAGMENT_S))
        return np.asarray(np.arange(first, int(high * FRAGMENT_S) + 1) / FRAGMENT_S)

    @cached_property
    def wavenumber(self) -> Float:
        """Rad/m."""
        return np.asarray(2 * np.pi * self.frequency_hz / self.air.speed_of_sound_m_s)

    @cached_property
    def emitted(self) -> Complex:
        """Spectrum of the chirp as the sensor emits and hears it."""
        samples = self.chirp.samples(AUDIO_RATE_HZ)
        size = scipy.fft.next_fast_len(16 * samples.size, real=True)
        grid_hz = scipy.fft.rfftfreq(size, 1 / AUDIO_RATE_HZ)
        # A chirp's phase turns too fast to be interpolated, and no ratio depends on it.
        level = np.interp(self.frequency_hz, grid_hz, np.abs(scipy.fft.rfft(samples, size)))
        return np.asarray(level * shipped_response().amplitude(self.frequency_hz), complex)

    def heard(self, radius_mm: float, tilt_rad: float, place: Place | None = None) -> Complex:
        """Spectrum of a dish's echo, shape (num_mics or 1, num_frequencies).

        A way r turns by e^{-ikr}. ``place`` is the receiver's own unless given.
        """
        at = place or self.place
        vertex, mics = _point(at), mic_positions_m()
        facing = at.azimuth_rad + np.pi + tilt_rad
        axis = np.array([np.cos(facing), np.sin(facing), 0.0])
        dish = Dish.landmark(radius_mm)
        body = dish_echoes(dish, axis, vertex, np.array(EMITTER_POSITION_M), mics).responses[0].body
        turn = np.exp(-1j * self.wavenumber * (body.path_m[:, None] - 2 * self.place.range_m))
        spectrum = body.spectrum(self.wavenumber) * turn
        return self._received(spectrum * self._way(vertex - np.array(EMITTER_POSITION_M)))

    def _way(self, leaving_m: Float) -> Float:
        """Emission toward a direction, and air there and back; shape (..., num_frequencies)."""
        distance = np.linalg.norm(leaving_m, axis=-1)
        sine = np.hypot(leaving_m[..., 1], leaving_m[..., 2]) / distance
        lost_db = self.air.absorption_db_m(self.frequency_hz) * 2 * distance[..., None]
        pattern = piston_pattern(self.wavenumber, sine[..., None])
        return np.asarray(10 ** (-lost_db / 20) * pattern * np.abs(self.emitted))

    def _received(self, spectrum: Complex) -> Complex:
        if not self.one_beam:
            return spectrum
        return np.asarray(np.mean(spectrum * np.conj(self._steering(_point(self.place))), axis=0))[
            None
        ]

    def _steering(self, points_m: Float) -> Complex:
        """Phase of each microphone for sound from points, shape (..., num_mics, num_freq)."""
        mics = mic_positions_m()
        back = np.linalg.norm(points_m[..., None, :] - mics, axis=-1)
        out = np.linalg.norm(points_m - np.array(EMITTER_POSITION_M), axis=-1)
        way = out[..., None] + back - 2 * self.place.range_m
        return np.asarray(np.exp(-1j * way[..., None] * self.wavenumber))

    @cached_property
    def covariance(self) -> Complex:
        """Of the interference, any scale: shape (num_frequencies, m, m), m microphones or 1."""
        around, above = (grid.ravel() for grid in np.meshgrid(_AROUND_RAD, _ABOVE_RAD))
        points = np.stack(
            [
                _point(Place(self.place.range_m, float(azimuth), float(elevation)))
                for azimuth, elevation in zip(around, above, strict=True)
            ]
        )
        power = self._way(points - np.array(EMITTER_POSITION_M)) ** 2
        if self.one_beam:
            # What is in the beam comes from where the dish is.
            own = self._way(_point(self.place) - np.array(EMITTER_POSITION_M)) ** 2
            clutter = own[:, None, None].astype(complex)
        else:
            steering = self._steering(points)
            clutter = np.einsum("df,dmf,dnf->fmn", power, steering, np.conj(steering))
        eye = np.eye(clutter.shape[1])
        share = (
            10 ** (NOISE_DB / 10)
            * self._compressed(clutter)
            / self._compressed(np.broadcast_to(eye, clutter.shape))
        )
        return np.asarray(clutter + share * eye)

    def _compressed(self, covariance: Complex) -> float:
        """Energy after compression, mean of the microphones."""
        power = np.einsum("fmm->f", covariance).real / covariance.shape[1]
        return float(power @ np.abs(self._weight) ** 2)

    @property
    def _weight(self) -> Float:
        """Of the compression: by the chirp, as the data sets' own_to_rest_db has it."""
        return np.asarray(np.abs(self.emitted) / shipped_response().amplitude(self.frequency_hz))

    def ratio(self, heard: Complex) -> float:
        """Energy of an echo against ``covariance``'s in its fragment, after compression."""
        power = np.mean(np.abs(heard) ** 2, axis=0)
        return float(power @ self._weight**2) / self._compressed(self.covariance)

    @cached_property
    def _whitener(self) -> Complex:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)))

    def whitened(self, heard: Complex) -> Complex:
        """An echo where interference has unit variance, shape (num_frequencies, m)."""
        return np.asarray(np.einsum("fmn,nf->fm", self._whitener, heard))


def receiver(range_m: float, azimuth_deg: float, *, one_beam: bool) -> Receiver:
    """One for the default chirp."""
    return Receiver(DEFAULT_CHIRP, Place(range_m, float(np.deg2rad(azimuth_deg))), one_beam)


def _point(place: Place) -> Float:
    flat = np.cos(place.elevation_rad)
    direction = np.array(
        [
            flat * np.cos(place.azimuth_rad),
            flat * np.sin(place.azimuth_rad),
            np.sin(place.elevation_rad),
        ]
    )
    return np.asarray(place.range_m * direction)
