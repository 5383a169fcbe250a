"""Sound in air: speed and absorption."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

_USUAL_C, _USUAL_PERCENT = 20.0, 50.0
_T0_K = 293.15
_TRIPLE_POINT_K = 273.16
_CELSIUS_0_K = 273.15
_DRY_AIR_0_C_M_S = 331.3
_DRY_AIR_G_MOL, _LIGHTER_G_MOL = 28.96, 10.95  # vapour: 18.01


@dataclass(frozen=True, slots=True)
class Air:
    """Still air at one atmosphere.

    temperature_c : float
        Degrees Celsius.
    humidity_percent : float
        Relative humidity, 0 to 100.
    """

    temperature_c: float = _USUAL_C
    humidity_percent: float = _USUAL_PERCENT

    @classmethod
    def measured(cls, temperature_c: float | None, humidity_percent: float | None) -> Air:
        """Of what somebody measured; 20 degrees and 50 % where nobody did."""
        return cls(
            _USUAL_C if temperature_c is None else temperature_c,
            _USUAL_PERCENT if humidity_percent is None else humidity_percent,
        )

    @property
    def speed_of_sound_m_s(self) -> float:
        """331.3 sqrt(1 + T / 273.15), and faster by the vapour in it, an ideal gas as well.

        Vapour is lighter than air, and its molecules take up more heat: with a share h of them the
        mean molar mass is 28.96 - 10.95 h g/mol, the ratio of specific heats (7 + h) / (5 + h); the
        speed goes with the root of ratio over mass. h is as ISO 9613-1:1993 has it.
        """
        dry = _DRY_AIR_0_C_M_S * math.sqrt(1 + self.temperature_c / _CELSIUS_0_K)
        h = self._molar_percent / 100
        heats = (7 + h) / (5 + h) / (7 / 5)
        return dry * math.sqrt(heats * _DRY_AIR_G_MOL / (_DRY_AIR_G_MOL - _LIGHTER_G_MOL * h))

    @property
    def _molar_percent(self) -> float:
        """Share of water molecules, percent; ISO 9613-1:1993, B.1 to B.3."""
        temperature_k = self.temperature_c + _CELSIUS_0_K
        exponent = -6.8346 * (_TRIPLE_POINT_K / temperature_k) ** 1.261 + 4.6151
        return float(self.humidity_percent * 10**exponent)  # at one atmosphere

    def absorption_db_m(self, frequency_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Pure-tone attenuation, dB/m, by ISO 9613-1:1993, equations 3 to 5 and B.3.

        Parameters
        ----------
        frequency_hz : float64, any shape
        """
        temperature_k = self.temperature_c + _CELSIUS_0_K
        ratio, molar = temperature_k / _T0_K, self._molar_percent
        oxygen_hz = 24 + 4.04e4 * molar * (0.02 + molar) / (0.391 + molar)
        nitrogen_hz = ratio**-0.5 * (9 + 280 * molar * np.exp(-4.170 * (ratio ** (-1 / 3) - 1)))
        f2 = frequency_hz**2
        classical = 1.84e-11 * ratio**0.5
        oxygen = 0.01275 * np.exp(-2239.1 / temperature_k) / (oxygen_hz + f2 / oxygen_hz)
        nitrogen = 0.1068 * np.exp(-3352.0 / temperature_k) / (nitrogen_hz + f2 / nitrogen_hz)
        return np.asarray(8.686 * f2 * (classical + ratio**-2.5 * (oxygen + nitrogen)))
