"""The dish as scenes hear it, and physical optics, against stored exact echoes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_simulator.landmark import RADII_MM, Dish, dish_echoes
from ertis_simulator.physical_optics import CapOptics
from ertis_simulator.reference.compare import Agreement, best_match, compare
from ertis_simulator.reference.table import ReferenceTable, Views
from ertis_simulator.validation.check import Check

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

EXACT = "boundary elements for a rigid thin cap"
_RADIUS_M = 0.05  # everything scales: any will do
_FAR_R = 1e5  # aperture radii
_OPTICS_KA = np.arange(20.0, 81.0, 4.0)
_ALLOWED_US = 0.5  # 0.09 mm of range
_SPEED_M_S = 343.0


def as_heard(ka: FloatArray, views: Views) -> ComplexArray:
    """The live simulator's dish, as ``reference.compare`` wants it."""
    dish = Dish.landmark(1000 * _RADIUS_M)
    k = ka / _RADIUS_M
    rows = []
    for source, mic, azimuth, range_r in zip(
        views.source_tilt_rad, views.mic_tilt_rad, views.azimuth_rad, views.range_r, strict=True
    ):
        range_m = _RADIUS_M * min(float(range_r), _FAR_R)
        emitter = range_m * _direction(source, 0.0)
        at = range_m * _direction(mic, azimuth)
        vertex = np.array([0.0, 0.0, -dish.sphere_radius_m])
        body = dish_echoes(dish, np.eye(3)[2], vertex, emitter, at[None]).responses[0].body
        # Scenes count time the other way round than the reference.
        turned = np.conj(body.spectrum(k)[0]) * np.exp(1j * k * (body.path_m[0] - 2 * range_m))
        rows.append(turned * range_m**2 / _RADIUS_M)
    return np.array(rows)


def checks() -> list[Check]:
    """Agreement over 20 to 80 kHz, worst of the four radii; the mean over the views named."""
    found = [compare(as_heard, radius / 1000) for radius in RADII_MM]
    views = found[0].views
    tilt, apart = np.rad2deg(views.bisector_tilt_rad), np.rad2deg(views.apart_rad)
    alone = (apart < 0.1) & np.isinf(views.range_r)
    groups = {
        "tilt 0 to 30 degrees": (alone & (tilt < 31), 0.04, 0.8),
        "tilt 35 to 60 degrees": (alone & (tilt > 31) & (tilt < 61), 0.1, 1.0),
        "tilt 65 to 90 degrees": (alone & (tilt > 61), 0.15, 2.0),
        "2 to 6 degrees apart, tilt to 45 degrees": (apart > 1, 0.1, 1.0),
        "70 mm and 35 mm at 0.6 m, tilt to 45 degrees": (np.isfinite(views.range_r), 0.15, 2.0),
    }
    rows = []
    for name, (chosen, allowed, allowed_db) in groups.items():
        rows += _rows(name, found, chosen, allowed, allowed_db)
    return [*rows, *_optics_checks()]


def _rows(
    name: str,
    found: list[Agreement],
    chosen: npt.NDArray[np.bool_],
    allowed: float,
    allowed_db: float,
) -> list[Check]:
    match = min(float(one.correlation[chosen].mean()) for one in found)
    levels = [float(one.level_db[chosen].mean()) for one in found]
    level = max(levels, key=abs)
    late_us = max(1e6 * float(np.abs(one.delay_s[chosen]).mean()) for one in found)
    return [
        Check(f"correlation, {name}", EXACT, 1.0, match, allowed, ""),
        Check(f"level, {name}", EXACT, 0.0, level, allowed_db, "dB"),
        Check(f"best delay, {name}", EXACT, 0.0, late_us, _ALLOWED_US, "us"),
    ]


def _optics_checks() -> list[Check]:
    """The two independent methods, neither fitted to the other; means over tilts."""
    table = ReferenceTable.load()
    apart = np.rad2deg(table.views.apart_rad)
    tilt = table.views.bisector_tilt_rad
    chosen = np.flatnonzero((apart < 0.1) & np.isinf(table.views.range_r) & (tilt < np.deg2rad(56)))
    columns = [np.argmin(abs(table.ka - ka)) for ka in _OPTICS_KA]
    exact = table.amplitude[np.ix_(chosen, columns)].astype(np.complex128)
    zero = np.zeros(len(chosen))
    optics = np.array(
        [CapOptics(0.6, ka).far_field(tilt[chosen], tilt[chosen], zero) for ka in _OPTICS_KA]
    ).T
    cross = optics * exact.conj()
    energies = [np.sum(np.abs(part) ** 2, axis=1) for part in (optics, exact)]
    matched, path = best_match(_OPTICS_KA, cross)
    match = float(np.mean(matched / np.sqrt(energies[0] * energies[1])))
    level_db = float(np.mean(10 * np.log10(energies[0] / energies[1])))
    late_us = float(np.abs(path).mean()) * max(RADII_MM) * 1e-3 / _SPEED_M_S * 1e6
    phase_deg = float(np.rad2deg(np.abs(np.angle(cross.sum(axis=1))).mean()))
    of = "of physical optics, 6 bounces, ka 20 to 80, tilt to 55 degrees"
    return [
        Check(f"correlation {of}", EXACT, 1.0, match, 0.05, ""),
        Check(f"level {of}", EXACT, 0.0, level_db, 1.0, "dB"),
        Check(f"best delay {of}, 70 mm", EXACT, 0.0, late_us, _ALLOWED_US, "us"),
        Check(f"phase {of}", EXACT, 0.0, phase_deg, 8.0, "degrees"),
    ]


def _direction(tilt_rad: float, azimuth_rad: float) -> FloatArray:
    flat = np.sin(tilt_rad)
    return np.array(
        [flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.cos(tilt_rad)], np.float64
    )
