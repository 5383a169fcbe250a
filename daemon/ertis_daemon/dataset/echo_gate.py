"""Is there an echo where a label says? Beams toward it, and the range gate against its vicinity."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ertis_detector.imaging import MIN_RANGE_M, RATE_HZ, Focus, MatchedFilter, unit_vectors
from ertis_driver.chirp import Emission
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m

# A label is read off a tape and a protractor; a dish returns up to 4 cm behind its vertex.
GATE_M = (-0.10, 0.14)
AROUND_M = 0.75  # to either side of the gate: what the echo must stand out of
# The beam is 6.5 degrees wide and 12 high; sonar and dish seldom stand at exactly one height.
_AZIMUTH_STEPS_RAD = np.deg2rad([-8.0, -4.0, 0.0, 4.0, 8.0])
_ELEVATION_STEPS_RAD = np.deg2rad([-8.0, 0.0, 8.0])
# Where the bearing is not known: all that the detector looks at.
_ALL_AZIMUTHS_RAD = np.deg2rad(np.arange(-60.0, 60.1, 6.0))
# Of 130 simulated labels 4 % lie below (landmarks that hardly return anything), of ranges that
# are wrong by over 0.4 m 71 %: in the others something else stands there.
WEAK_DB = 10.0
RINGING_M = 1.0
_FOCUS_M = 2.5


class EchoGate:
    """Looks for the echo that a label claims. Not for use by two threads at once.

    Parameters
    ----------
    chirp
        What was emitted.
    num_words : int
        Of each ping, at 4.5 MHz.
    speed_of_sound_m_s : float

    Raises
    ------
    ValueError
        If a ping is too short for the chirp to return in.
    """

    def __init__(self, chirp: Emission, num_words: int, speed_of_sound_m_s: float) -> None:
        samples = chirp.samples(AUDIO_RATE_HZ)
        num_samples = num_words // DECIMATION
        if num_samples <= 2 * samples.size:
            raise ValueError(
                f"{num_words} words a ping, expected over {2 * samples.size * DECIMATION}: twice "
                "the chirp"
            )
        self._filter = MatchedFilter(samples, num_samples, chirp.band_hz)
        self._focus = Focus(
            mic_positions_m(),
            np.array(EMITTER_POSITION_M),
            self._filter.baseband,
            speed_of_sound_m_s,
        )
        self._cell_m = speed_of_sound_m_s / 2 / RATE_HZ
        blank_m = self._filter.blank / AUDIO_RATE_HZ * speed_of_sound_m_s / 2
        self._first_m = max(MIN_RANGE_M, blank_m)
        self._last_m = self._filter.baseband.num_samples * self._cell_m

    def level_db(self, audio: npt.NDArray[np.float32], range_m: float, azimuth_rad: float) -> float:
        """Level of the strongest echo in the gate over the median of what is around.

        Parameters
        ----------
        audio : float32, shape (32, num_words // 10)
        range_m : float
        azimuth_rad : float
            NaN looks everywhere.

        Returns
        -------
        float
            dB; NaN if the gate lies outside of what a ping can tell.
        """
        low, high = range_m + GATE_M[0], range_m + GATE_M[1]
        first_m = max(self._first_m, low - AROUND_M)
        last_m = min(self._last_m, high + AROUND_M)
        if not (high > first_m and low < last_m):  # also if the range is NaN
            return math.nan
        power, at_m = self._power(audio, range_m, azimuth_rad, first_m, last_m)
        gate = (at_m >= low) & (at_m <= high)
        if gate.all() or not gate.any():
            return math.nan
        return _db(power[gate].max(), power[~gate])

    def clearest(self, audio: npt.NDArray[np.float32], azimuth_rad: float) -> tuple[float, float]:
        """Range (m) and level (dB) of the echo that stands out most toward a bearing.

        Nearer than 1 m the emitter's ringing hides echoes, and is not taken for one.
        """
        power, at_m = self._power(audio, _FOCUS_M, azimuth_rad, RINGING_M, self._last_m)
        reach = int(AROUND_M / self._cell_m)
        best_m, best_db = float(at_m[0]), -math.inf
        step = max(1, int((GATE_M[1] - GATE_M[0]) / 2 / self._cell_m))
        for first in range(0, power.size, step):
            peak = first + int(np.argmax(power[first : first + step]))
            level_db = _db(power[peak], power[max(0, peak - reach) : peak + reach])
            if level_db > best_db:
                best_m, best_db = float(at_m[peak]), level_db
        return round(best_m, 3), best_db

    def _power(
        self,
        audio: npt.NDArray[np.float32],
        focus_m: float,
        azimuth_rad: float,
        first_m: float,
        last_m: float,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float64]]:
        """Strongest over all beams by range, and the ranges, m."""
        known = not math.isnan(azimuth_rad)
        azimuths = azimuth_rad + _AZIMUTH_STEPS_RAD if known else _ALL_AZIMUTHS_RAD
        azimuth, elevation = np.meshgrid(azimuths, _ELEVATION_STEPS_RAD)
        points = focus_m * unit_vectors(azimuth.ravel(), elevation.ravel())
        before = math.floor((focus_m - first_m) / self._cell_m)
        length = max(1, int((last_m - first_m) / self._cell_m))
        beams = self._focus.beam(self._filter(audio), points, before, length)
        power = np.max(beams.real**2 + beams.imag**2, axis=0)
        return power, focus_m + self._cell_m * (np.arange(power.size) - before)


def _db(power: np.float32, floor: npt.NDArray[np.float32]) -> float:
    return round(10 * math.log10((float(power) + 1e-30) / (float(np.median(floor)) + 1e-30)), 2)
