"""Air: absorption against the standard's printed table, speed of sound against a data book."""

from __future__ import annotations

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
# Dry air, 0.0314 % CO2: Cramer, J. Acoust. Soc. Am. 93 (1993) 2510, gives 331.45 m/s at 0 C.
DRY_AIR_0C_M_S = 331.45


def midband_hz(step: int) -> float:
    """Exact midband frequency, ``step`` thirds of an octave from 1 kHz, as the table uses it."""
    return float(1000 * 10 ** (step / 10))


def computed_db_km(celsius: float, percent: float, step: int) -> float:
    """What the simulator's air absorbs there, dB/km."""
    absorbed = Air(celsius, percent).absorption_db_m(np.array(midband_hz(step)))
    return float(1000 * absorbed)


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
    rows.append(
        Check(
            "speed of sound, 0 C",
            "dry air, Cramer 1993",
            DRY_AIR_0C_M_S,
            Air(0.0, 50.0).speed_of_sound_m_s,
            0.3,
            "m/s",
        )
    )
    ideal = DRY_AIR_0C_M_S * np.sqrt(1 + 20 / 273.15)
    found = Air(20.0, 50.0).speed_of_sound_m_s
    rows.append(
        Check("speed of sound, 20 C", "the same, as sqrt(T)", float(ideal), found, 0.3, "m/s")
    )
    return rows
