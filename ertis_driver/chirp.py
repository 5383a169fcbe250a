"""The emitted sweep: what it is, its samples, and the DAC codes that the device is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from ertis_driver.errors import SettingsError

ChirpKind = Literal["hyperbolic", "linear"]

DAC_IDLE_CODE = 2048  # 12 bits, mid-scale
MIN_DAC_RATE_HZ, MAX_DAC_RATE_HZ = 160_000, 2_000_000
MIN_DAC_SAMPLES, MAX_DAC_SAMPLES = 64, 65_535


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
        if not MIN_DAC_RATE_HZ <= self.dac_rate_hz <= MAX_DAC_RATE_HZ:
            raise SettingsError(
                f"DAC rate {self.dac_rate_hz} Hz, expected {MIN_DAC_RATE_HZ} to {MAX_DAC_RATE_HZ}"
            )
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
        if not MIN_DAC_SAMPLES <= self.num_dac_samples <= MAX_DAC_SAMPLES:
            raise SettingsError(
                f"chirp of {self.num_dac_samples} DAC samples, expected {MIN_DAC_SAMPLES} to "
                f"{MAX_DAC_SAMPLES}: change duration or DAC rate"
            )

    @property
    def num_dac_samples(self) -> int:
        """Number of samples the device plays: both ends are included."""
        return round(self.duration_s * self.dac_rate_hz) + 1

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
        codes = np.floor(2047 * self.samples(self.dac_rate_hz) + DAC_IDLE_CODE)
        return np.asarray(codes.astype(np.uint16))


DEFAULT_CHIRP = Chirp()  # 80 to 20 kHz: the dish's rings need this bandwidth to be told apart
INCUMBENT_CHIRP = Chirp(f_start_hz=50_000.0, f_stop_hz=25_000.0)  # what older recordings hold
