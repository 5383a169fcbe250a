"""Sound in air: speed and absorption."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_T0_K = 293.15
_TRIPLE_POINT_K = 273.16
_PRESSURE_PA = 101_325.0


@dataclass(frozen=True, slots=True)
class Air:
    """Still air at one atmosphere.

    temperature_c : float
        Degrees Celsius.
    humidity_percent : float
        Relative humidity, 0 to 100.
    """

    temperature_c: float = 20.0
    humidity_percent: float = 50.0

    @property
    def speed_of_sound_m_s(self) -> float:
        """331.3 sqrt(1 + T / 273.15)."""
        return float(331.3 * np.sqrt(1 + self.temperature_c / 273.15))

    def absorption_db_m(self, frequency_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pure-tone attenuation, dB/m, by ISO 9613-1:1993, equations 3 to 5 and B.3.

        Parameters
        ----------
        frequency_hz : float64, any shape
        """
        temperature_k = self.temperature_c + 273.15
        ratio = temperature_k / _T0_K
        saturation = 10 ** (-6.8346 * (_TRIPLE_POINT_K / temperature_k) ** 1.261 + 4.6151)
        molar = self.humidity_percent * saturation  # percent; at one atmosphere
        oxygen_hz = 24 + 4.04e4 * molar * (0.02 + molar) / (0.391 + molar)
        nitrogen_hz = ratio**-0.5 * (9 + 280 * molar * np.exp(-4.170 * (ratio ** (-1 / 3) - 1)))
        f2 = frequency_hz**2
        classical = 1.84e-11 * ratio**0.5
        oxygen = 0.01275 * np.exp(-2239.1 / temperature_k) / (oxygen_hz + f2 / oxygen_hz)
        nitrogen = 0.1068 * np.exp(-3352.0 / temperature_k) / (nitrogen_hz + f2 / nitrogen_hz)
        return np.asarray(8.686 * f2 * (classical + ratio**-2.5 * (oxygen + nitrogen)))
