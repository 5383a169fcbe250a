"""A chirp of arbitrary samples, read from a CSV file."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import (
    DAC_IDLE_CODE,
    MAX_DAC_SAMPLES,
    check_dac_rate,
    check_num_samples,
    to_dac_codes,
)
from ertis_driver.errors import SettingsError

MAX_LINE_CHARS = 200  # two numbers; a longer line is another kind of file
_BAND_FLOOR = 0.1  # -20 dB of the strongest frequency: below it is what ramps and rounding spread
_TIME_STEP_ERROR = 0.01  # of a step: times written with few digits are still even


@dataclass(frozen=True, slots=True)
class CustomChirp:
    """Any samples; implements ``Emission``.

    Parameters
    ----------
    codes
        DAC codes, 12 bits, idle 2048.
    dac_rate_hz
        Rate at which the device plays them, Hz.

    Raises
    ------
    SettingsError
        If the device could not play it.
    """

    codes: tuple[int, ...]
    dac_rate_hz: int = 450_000

    def __post_init__(self) -> None:
        check_dac_rate(self.dac_rate_hz)
        check_num_samples(len(self.codes))
        for index, code in enumerate(self.codes):
            if not (isinstance(code, int) and 0 <= code <= 4095):
                raise SettingsError(f"DAC code {index} is {code}, expected 0 to 4095")
        if len(set(self.codes)) == 1:
            raise SettingsError("all samples of the chirp are equal, expected a sound")

    @classmethod
    def from_samples(cls, samples: npt.ArrayLike, dac_rate_hz: int = 450_000) -> CustomChirp:
        """Make a chirp of samples in [-1, 1], shape (n,).

        Raises
        ------
        SettingsError
            If a sample is outside, or the device could not play it.
        """
        values = np.asarray(samples, np.float64)
        if values.ndim != 1:
            raise SettingsError(f"chirp samples of shape {values.shape}, expected (n,)")
        bad = np.flatnonzero(~(np.abs(values) <= 1))
        if bad.size:
            raise SettingsError(f"chirp sample {bad[0]} is {values[bad[0]]:g}, expected -1 to 1")
        return cls(tuple(to_dac_codes(values).tolist()), dac_rate_hz)

    @property
    def num_dac_samples(self) -> int:
        """Number of samples the device plays."""
        return len(self.codes)

    @property
    def duration_s(self) -> float:
        """From the first sample to the last, s."""
        return (len(self.codes) - 1) / self.dac_rate_hz

    @property
    def name(self) -> str:
        """``custom:`` and a hash of what is emitted: equal names are equal sounds."""
        content = self.dac_codes().astype("<u2").tobytes() + str(self.dac_rate_hz).encode()
        return f"custom:{hashlib.sha256(content).hexdigest()[:16]}"

    @property
    def band_hz(self) -> tuple[float, float]:
        """Lowest and highest frequency less than 20 dB below the strongest one, Hz."""
        samples = (self.dac_codes().astype(np.float64) - DAC_IDLE_CODE) / 2047
        level = np.abs(np.fft.rfft(samples - samples.mean()))
        ends = np.flatnonzero(level > _BAND_FLOOR * level.max())[[0, -1]]
        low, high = (ends * self.dac_rate_hz / len(self.codes)).tolist()
        return float(low), float(high)

    def samples(self, rate_hz: float) -> npt.NDArray[np.float64]:
        """It at another rate (band-limited); float64, shape (duration * rate + 1,).

        Raises
        ------
        SettingsError
            If the rate is no whole number of Hz.
        """
        samples = (self.dac_codes().astype(np.float64) - DAC_IDLE_CODE) / 2047
        if rate_hz == self.dac_rate_hz:
            return samples
        if rate_hz != int(rate_hz) or rate_hz <= 0:
            raise SettingsError(f"sample rate {rate_hz} Hz, expected a whole number above 0")
        common = math.gcd(int(rate_hz), self.dac_rate_hz)
        size = round(self.duration_s * rate_hz) + 1
        from scipy.signal import resample_poly  # 75 MB and seconds: only who needs it pays

        resampled = resample_poly(samples, int(rate_hz) // common, self.dac_rate_hz // common)
        return np.asarray(np.clip(resampled[:size], -1.0, 1.0))

    def dac_codes(self) -> npt.NDArray[np.uint16]:
        """What the device is told to play; uint16, shape (n,), 12 bits."""
        return np.array(self.codes, np.uint16)


def read_chirp_csv(path: str | Path, dac_rate_hz: int | None = None) -> CustomChirp:
    """Read a chirp: one sample a line in [-1, 1], or time (s) and sample with a comma between.

    Times must be evenly spaced; they give the DAC rate. Empty lines and those that begin with
    ``#`` are passed over; a heading is not.

    Parameters
    ----------
    path
        At most 65535 samples.
    dac_rate_hz
        450 kHz if neither this nor times are given.

    Raises
    ------
    SettingsError
        With the line number, if the file is anything else, or the device could not play it.
    """
    path = Path(path)
    try:
        rows = _read_rows(path)
    except OSError as error:
        raise SettingsError(f"cannot read chirp {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SettingsError(f"{path} is no text, expected one sample a line") from error
    try:
        check_num_samples(len(rows))
        rate_hz = _rate_from_times(path, rows) if rows[0].time_s is not None else None
        if rate_hz is not None and dac_rate_hz not in (None, rate_hz):
            raise SettingsError(
                f"its times say {rate_hz} Hz, asked for {dac_rate_hz}: leave one of them out"
            )
        return CustomChirp.from_samples(
            [row.sample for row in rows], rate_hz or dac_rate_hz or 450_000
        )
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    time_s: float | None
    sample: float


def _read_rows(path: Path) -> list[_Row]:
    rows: list[_Row] = []
    with path.open(encoding="utf-8-sig") as file:
        for number in count(1):
            text = file.readline(MAX_LINE_CHARS)
            if not text or len(rows) > MAX_DAC_SAMPLES:
                break
            if text.strip() and not text.startswith("#"):
                rows.append(_row(path, number, text.strip()))
                if (rows[0].time_s is None) != (rows[-1].time_s is None):
                    raise SettingsError(
                        f"{path}:{number}: {text.strip()!r}, expected as many columns as in "
                        f"line {rows[0].line}"
                    )
    return rows


def _row(path: Path, number: int, text: str) -> _Row:
    try:
        values = [float(field) for field in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(map(math.isfinite, values)):
        raise SettingsError(
            f"{path}:{number}: {text[:40]!r}, expected a sample, or time and sample"
        )
    if not -1 <= values[-1] <= 1:
        raise SettingsError(f"{path}:{number}: sample {values[-1]:g}, expected -1 to 1")
    return _Row(number, values[0] if len(values) == 2 else None, values[-1])


def _rate_from_times(path: Path, rows: list[_Row]) -> int:
    times = np.array([row.time_s for row in rows], np.float64)
    step_s = (times[-1] - times[0]) / (len(times) - 1)
    even = times[0] + step_s * np.arange(len(times))
    late = np.flatnonzero(~(np.abs(times - even) <= _TIME_STEP_ERROR * step_s))
    if step_s <= 0 or late.size:
        row = rows[late[0] if late.size else 0]
        raise SettingsError(f"line {row.line}: time {row.time_s:g} s, expected even steps upward")
    rate_hz = round(float(1 / step_s))
    check_dac_rate(rate_hz)
    return rate_hz
