"""What is emitted: sweeps, their samples, and the DAC codes that the device is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from ertis_driver.errors import SettingsError

ChirpKind = Literal["hyperbolic", "linear"]

DAC_IDLE_CODE = 2048  # 12 bits, mid-scale
MIN_DAC_RATE_HZ, MAX_DAC_RATE_HZ = 160_000, 2_000_000
MIN_DAC_SAMPLES, MAX_DAC_SAMPLES = 64, 65_535


class Emission(Protocol):
    """What a device can emit: a ``Chirp`` or a ``CustomChirp``. Equal if it sounds equal."""

    @property
    def name(self) -> str:
        """What recordings, models and events call it."""

    @property
    def dac_rate_hz(self) -> int:
        """Rate at which the device plays it, Hz."""

    @property
    def num_dac_samples(self) -> int:
        """Number of samples the device plays."""

    @property
    def duration_s(self) -> float:
        """Length, s."""

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency in it, Hz."""

    def samples(self, rate_hz: float) -> npt.NDArray[np.float64]:
        """It at another rate, in [-1, 1]; float64, shape (duration * rate + 1,)."""

    def dac_codes(self) -> npt.NDArray[np.uint16]:
        """What the device is told to play; uint16, shape (n,), 12 bits."""


@dataclass(frozen=True, slots=True)
class Chirp:
    """A frequency sweep with Hann ramps at both ends.

    Parameters
    ----------
    kind
        ``hyperbolic`` (Doppler tolerant, the incumbent's) or ``linear`` (the paper's).
    f_start_hz, f_stop_hz
        First and last frequency, Hz. A bat, and an eRTIS, sweeps downward.
    duration_s
        Length, s.
    ramp
        Part of the samples that each Hann ramp covers, 0 to 0.5.
    dac_rate_hz
        Rate at which the device plays it, Hz.

    Raises
    ------
    SettingsError
        If the device could not play it.
    """

    kind: ChirpKind = "hyperbolic"
    f_start_hz: float = 80_000.0
    f_stop_hz: float = 20_000.0
    duration_s: float = 2.5e-3
    ramp: float = 0.1
    dac_rate_hz: int = 450_000

    def __post_init__(self) -> None:
        if self.kind not in get_args(ChirpKind):
            raise SettingsError(
                f"chirp kind {self.kind!r}, expected one of {', '.join(get_args(ChirpKind))}"
            )
        check_dac_rate(self.dac_rate_hz)
        for name, value in (("start", self.f_start_hz), ("stop", self.f_stop_hz)):
            if not 0 < value < self.dac_rate_hz / 2:
                raise SettingsError(
                    f"chirp {name} frequency {value:g} Hz, expected above 0 and below "
                    f"{self.dac_rate_hz / 2:g} (half the DAC rate)"
                )
        if self.kind == "hyperbolic" and self.f_start_hz == self.f_stop_hz:
            raise SettingsError("a hyperbolic chirp needs two different frequencies")
        if not 0 <= self.ramp <= 0.5:
            raise SettingsError(f"chirp ramp {self.ramp:g}, expected 0 to 0.5 of the samples")
        if not (self.duration_s > 0 and np.isfinite(self.duration_s)):
            raise SettingsError(f"chirp duration {self.duration_s:g} s, expected above 0")
        check_num_samples(self.num_dac_samples)

    @property
    def num_dac_samples(self) -> int:
        """Number of samples the device plays: both ends are included."""
        return round(self.duration_s * self.dac_rate_hz) + 1

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency of the sweep, Hz."""
        low, high = sorted((self.f_start_hz, self.f_stop_hz))
        return low, high

    @property
    def name(self) -> str:
        """The sweep as text, ``kind:start:stop:duration`` in Hz and s; ``parse`` reads it."""
        return f"{self.kind}:{self.f_start_hz:g}:{self.f_stop_hz:g}:{self.duration_s:g}"

    @classmethod
    def parse(cls, text: str) -> Chirp:
        """Read ``kind:start_hz:stop_hz:duration_s``.

        >>> Chirp.parse("hyperbolic:50000:25000:0.0025").f_stop_hz
        25000.0

        Raises
        ------
        SettingsError
            If the text is of another form or the values cannot be played.
        """
        parts = text.split(":")
        if parts[0] == "custom":
            raise SettingsError(
                f"chirp {text!r} is known by its samples only, expected kind:start_hz:stop_hz:"
                "duration_s: name the recording or the CSV file that holds it"
            )
        try:
            kind, start, stop, duration = parts
            values = float(start), float(stop), float(duration)
        except ValueError as error:
            raise SettingsError(
                f"chirp {text!r}, expected kind:start_hz:stop_hz:duration_s, "
                f"for example {DEFAULT_CHIRP.name}"
            ) from error
        return cls(kind, *values)  # type: ignore[arg-type]  # the kind is checked in __post_init__

    def at(self, times_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The sweep at any times, in [-1, 1]; zero outside it.

        Hyperbolic: s(t) = sin(2 pi / k ln(1 + k f1 t)), k = (1/f0 - 1/f1) / T with f1 the first
        and f0 the last frequency. Linear: the usual quadratic phase.

        Parameters
        ----------
        times_s : float64, any shape
            Seconds after the first sample.
        """
        inside = (times_s >= 0) & (times_s <= self.duration_s)
        t = np.where(inside, times_s, 0.0)
        f1, f0, duration = self.f_start_hz, self.f_stop_hz, self.duration_s
        if self.kind == "hyperbolic":
            k = (1 / f0 - 1 / f1) / duration
            phase = 2 * np.pi / k * np.log1p(k * f1 * t)
        else:
            phase = 2 * np.pi * (f1 * t + (f0 - f1) / (2 * duration) * t * t)
        edge = np.minimum(t, duration - t)
        ramp_s = self.ramp * duration
        envelope = np.ones_like(t)
        if ramp_s > 0:
            envelope = np.where(edge < ramp_s, 0.5 - 0.5 * np.cos(np.pi * edge / ramp_s), 1.0)
        return np.asarray(np.where(inside, envelope * np.sin(phase), 0.0))

    def samples(self, rate_hz: float) -> npt.NDArray[np.float64]:
        """The sweep sampled at ``rate_hz``; float64, shape (duration * rate + 1,)."""
        return self.at(np.arange(round(self.duration_s * rate_hz) + 1) / rate_hz)

    def dac_codes(self) -> npt.NDArray[np.uint16]:
        """What the device is told to play: floor(2047 s + 2048); uint16, shape (n,), 12 bits."""
        return to_dac_codes(self.samples(self.dac_rate_hz))


def to_dac_codes(samples: npt.NDArray[np.float64]) -> npt.NDArray[np.uint16]:
    """12-bit codes of samples in [-1, 1]: floor(2047 s + 2048); uint16, any shape."""
    return np.asarray(np.floor(2047 * samples + DAC_IDLE_CODE).astype(np.uint16))


def check_dac_rate(dac_rate_hz: int) -> None:
    """Refuse a DAC rate that the device does not have.

    Raises
    ------
    SettingsError
    """
    if not isinstance(dac_rate_hz, int) or not MIN_DAC_RATE_HZ <= dac_rate_hz <= MAX_DAC_RATE_HZ:
        raise SettingsError(
            f"DAC rate {dac_rate_hz} Hz, expected a whole number from {MIN_DAC_RATE_HZ} to "
            f"{MAX_DAC_RATE_HZ}"
        )


def check_num_samples(num_samples: int) -> None:
    """Refuse a number of samples that the device's memory does not take.

    Raises
    ------
    SettingsError
    """
    if not MIN_DAC_SAMPLES <= num_samples <= MAX_DAC_SAMPLES:
        raise SettingsError(
            f"chirp of {num_samples} DAC samples, expected {MIN_DAC_SAMPLES} to "
            f"{MAX_DAC_SAMPLES}: change duration or DAC rate"
        )


DEFAULT_CHIRP = Chirp()  # 80 to 20 kHz: the dish's rings need this bandwidth to be told apart
INCUMBENT_CHIRP = Chirp(f_start_hz=50_000.0, f_stop_hz=25_000.0)  # what older recordings hold
# The paper wishes linear sweeps, 180 to 30 kHz in 1 ms and 160 to 10 kHz in 6 ms. Transducer and
# microphones follow neither above some 80 kHz nor below 20 kHz, so the ends are limited to these.
# The durations stay, and with them the energy; the slope (Hz/s) is less than the paper's.
PAPER_SHORT_CHIRP = Chirp("linear", 80_000.0, 30_000.0, 1e-3)
PAPER_LONG_CHIRP = Chirp("linear", 80_000.0, 20_000.0, 6e-3)
