"""Response of transducer and microphones together, on axis: the shipped one, or a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_simulator.errors import SceneError

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

MAX_RESPONSE_BYTES = 1_000_000
MAX_LEVEL_DB = 200.0
MAX_DELAY_US = 1000.0  # a transducer that rings for longer is no sonar's
_HEADER = "frequency_hz,level_db"
_HEADERS = (_HEADER, f"{_HEADER},delay_us")


@dataclass(frozen=True, slots=True, eq=False)
class SensorResponse:
    """Response of transducer and microphones together, on axis.

    frequency_hz : float64, shape (n,)
        Rising.
    level_db : float64, shape (n,)
        Against ``AMPLITUDE_AT_1M``; the shipped one is 0 at 50 kHz.
    delay_s : float64, shape (n,)
        Group delay; the shipped one has none.
    """

    frequency_hz: FloatArray
    level_db: FloatArray
    delay_s: FloatArray

    @property
    def longest_delay_s(self) -> float:
        """By how much it makes an echo longer."""
        return float(self.delay_s.max())

    def amplitude(self, frequency_hz: FloatArray) -> FloatArray:
        """Amplitude at frequencies of any shape, interpolated in dB, constant outside."""
        return np.asarray(10 ** (np.interp(frequency_hz, self.frequency_hz, self.level_db) / 20))

    def response(self, frequency_hz: FloatArray) -> FloatArray | ComplexArray:
        """Amplitude, turned by the delay: its integral over frequency, straight between rows."""
        amplitude = self.amplitude(frequency_hz)
        if not self.delay_s.any():
            return amplitude
        knots = np.concatenate([[0.0], self.frequency_hz])
        delay = np.concatenate([self.delay_s[:1], self.delay_s])
        turns = np.cumsum((delay[1:] + delay[:-1]) / 2 * np.diff(knots))
        turns = np.concatenate([[0.0], turns])
        row = np.searchsorted(knots, frequency_hz, side="right") - 1
        here = np.interp(frequency_hz, knots, delay)
        turns = turns[row] + (frequency_hz - knots[row]) * (delay[row] + here) / 2
        return np.asarray(amplitude * np.exp(-2j * np.pi * turns))

    @classmethod
    def read(cls, path: Path) -> SensorResponse:
        """A calibration: CSV, ``frequency_hz,level_db``, perhaps ``,delay_us``; ``#`` comments.

        Raises
        ------
        SceneError
            If the file cannot be read or holds no such table.
        """
        try:
            if path.stat().st_size > MAX_RESPONSE_BYTES:
                raise SceneError(
                    f"{path}: larger than {MAX_RESPONSE_BYTES} bytes: that is no sensor response"
                )
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or "is not text"
            raise SceneError(f"sensor response {path}: {reason}") from error
        return cls._parse(text, str(path))

    @classmethod
    def _parse(cls, text: str, name: str) -> SensorResponse:
        rows: list[tuple[float, ...]] = []
        for number, line in enumerate(text.splitlines(), 1):
            kept = line.split("#")[0].strip()
            if kept and kept.replace(" ", "") not in _HEADERS:
                rows.append(_row(kept, rows, f"{name}:{number}"))
        if len(rows) < 2:
            raise SceneError(
                f"{name}: met {len(rows)} rows, expected two rows or more of {_HEADER}"
            )
        frequency_hz, level_db, *delay_us = np.array(rows).T
        delay_s = delay_us[0] * 1e-6 if delay_us else np.zeros(len(rows))
        return cls(frequency_hz, level_db, delay_s)


def _row(line: str, before: list[tuple[float, ...]], where: str) -> tuple[float, ...]:
    """One line of a calibration: as many numbers as the line before."""
    met = f"{where}: met {line[:40]!r}"
    try:
        cells = tuple(float(cell) for cell in line.split(","))
    except ValueError:
        cells = ()
    if len(cells) not in ((len(before[-1]),) if before else (2, 3)):
        raise SceneError(
            f"{met}, expected rows like 50000,0 under {_HEADER}, each perhaps with a delay_us"
        )
    frequency_hz, level_db, *delay_us = cells
    if not (math.isfinite(frequency_hz) and abs(level_db) <= MAX_LEVEL_DB):
        raise SceneError(f"{met}, expected finite numbers, levels within {MAX_LEVEL_DB:g} dB")
    if delay_us and not 0 <= delay_us[0] <= MAX_DELAY_US:
        raise SceneError(f"{met}, expected delays from 0 to {MAX_DELAY_US:g} us")
    lowest = before[-1][0] if before else -1.0
    if frequency_hz < 0 or frequency_hz <= lowest:
        expected = "expected frequencies rising from 0 Hz on"
        raise SceneError(f"{where}: met {frequency_hz:g} Hz after {max(lowest, 0):g}, {expected}")
    return cells


@cache
def shipped_response() -> SensorResponse:
    """The response in ``data/sensor_response.csv``, which names its sources."""
    file = resources.files("ertis_simulator") / "data/sensor_response.csv"
    return SensorResponse._parse(file.read_text(encoding="utf-8"), file.name)
