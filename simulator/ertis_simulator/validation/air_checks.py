"""Air: absorption against the standard's printed table, speed of sound against a data book."""

from __future__ import annotations

import math

import numpy as np

from ertis_detector.air import Air
from ertis_simulator.validation.check import Check

# ISO 9613-1:1993, table 1, dB/km at one atmosphere: (Celsius, percent, step of a third octave from
# 1 kHz, printed). As reproduced in open test suites of two implementations of the standard.
PRINTED_DB_KM = (
    (-20, 10, 0, 1.65),
    (-20, 70, 9, 27.8),
    (-10, 70, 9, 86.2),
    (0, 10, 0, 14.0),
    (0, 10, 6, 19.0),
    (0, 10, 9, 26.4),
    (0, 70, 0, 4.64),
    (10, 10, 0, 21.6),
    (10, 10, 9, 69.4),
    (10, 70, 0, 3.66),
    (10, 70, 6, 32.8),
    (15, 70, 6, 26.4),
    (20, 10, 0, 14.1),
    (20, 10, 6, 109.0),
    (20, 10, 7, 133.0),
    (20, 70, 0, 4.98),
    (20, 80, 7, 30.6),
    (20, 100, 6, 19.4),
    (30, 10, 6, 96.0),
    (30, 70, 6, 23.1),
    (50, 10, 9, 155.0),
    (50, 70, 0, 8.03),
    (50, 70, 6, 48.2),
    (50, 70, 9, 80.3),
)
TABLE = "ISO 9613-1:1993, table 1"
SPEED_AT = ((0, 0), (0, 100), (10, 50), (20, 0), (20, 50), (20, 100), (30, 50), (30, 90))
_CO2 = 314e-6  # mole fraction
_PRESSURE_PA = 101_325.0


def midband_hz(step: int) -> float:
    """Exact midband frequency, ``step`` thirds of an octave from 1 kHz, as the table uses it."""
    return float(1000 * 10 ** (step / 10))


def computed_db_km(celsius: float, percent: float, step: int) -> float:
    """What the simulator's air absorbs there, dB/km."""
    absorbed = Air(celsius, percent).absorption_db_m(np.array(midband_hz(step)))
    return float(1000 * absorbed)


def cramer_m_s(celsius: float, percent: float) -> float:
    """Speed of sound in moist air, m/s; 0 to 30 C, 300 ppm claimed.

    Cramer, J. Acoust. Soc. Am. 93 (1993) 2510: equation 15, table III, and the saturation pressure
    of its appendix.
    """
    t, kelvin, p = celsius, celsius + 273.15, _PRESSURE_PA
    saturation_pa = math.exp(
        1.2811805e-5 * kelvin**2 - 1.9509874e-2 * kelvin + 34.04926034 - 6353.6311 / kelvin
    )
    enhancement = 1.00062 + 3.14e-8 * p + 5.6e-7 * t**2
    water = percent / 100 * enhancement * saturation_pa / p
    return (
        331.5024
        + 0.603055 * t
        - 0.000528 * t**2
        + (51.471935 + 0.1495874 * t - 0.000782 * t**2) * water
        + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p
        - (85.20931 + 0.228525 * t - 5.91e-5 * t**2) * _CO2
        - 2.835149 * water**2
        - 2.15e-13 * p**2
        + 29.179762 * _CO2**2
        + 0.000486 * water * p * _CO2
    )


def worst_percent() -> tuple[float, str]:
    """Largest deviation from the printed figures, in percent of them, and where."""
    off = [
        (abs(computed_db_km(*row[:3]) / row[3] - 1) * 100, f"{row[0]} C, {row[1]} %")
        for row in PRINTED_DB_KM
    ]
    return max(off)


def checks() -> list[Check]:
    """Absorption and speed of sound."""
    rows = [
        Check(
            f"absorption, {celsius} C, {percent} %, {midband_hz(step) / 1e3:.3g} kHz",
            TABLE,
            printed,
            computed_db_km(celsius, percent, step),
            0.01 * printed,
            "dB/km",
        )
        for celsius, percent, step, printed in PRINTED_DB_KM
        if step > 0
    ]
    worst, _ = worst_percent()
    count = len(PRINTED_DB_KM)
    rows.append(Check(f"absorption, worst of {count} printed values", TABLE, 0, worst, 1.0, "%"))
    rows += [
        Check(
            f"speed of sound, {celsius} C, {percent} %",
            "Cramer 1993, equation 15",
            cramer_m_s(celsius, percent),
            Air(celsius, percent).speed_of_sound_m_s,
            0.3,
            "m/s",
        )
        for celsius, percent in SPEED_AT
    ]
    return rows
