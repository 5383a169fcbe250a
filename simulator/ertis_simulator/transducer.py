"""The emitter: loudness, direct path, ring-down; its response is in ``sensor_response``."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from ertis_detector.piston import PISTON_RADIUS_M
from ertis_simulator.echoes import Echoes

FloatArray = npt.NDArray[np.float64]

# Amplitude (full scale = 1) at 1 m on axis at 50 kHz: with it the real ping's echo from 3.74 m, 5.5
# degrees off the axis, is that of a perfect wall. Its echo from 3.20 m is 4 dB stronger than a wall
# could be (docs/validation.md); less would make both impossible.
AMPLITUDE_AT_1M = 2.2
# Beside itself the emitter is weaker than a piston in an endless baffle: by this much the direct
# path of the real ping is met at 46 kHz, where its chirp is strong.
DIRECT_PATH_DB = -4.4

# After the direct path the housing rings, falling fast for 1 ms, then slowly: energy per ms against
# the emission at 1 m at 50 kHz, less DIRECT_PATH_DB, read off one real ping. It is stronger at low
# frequencies than the response on axis says.
RING_DOWN = ((2.0, 26.0), (-14.0, 7.7))  # (dB at its beginning, dB/ms down)
RING_DOWN_EXPONENT = -2.2
RING_DOWN_S = 7e-3
_RING_DOWN_TAPS = 400
_BESIDE = 10 ** (DIRECT_PATH_DB / 20)
_REFERENCE_K = 2 * np.pi * 50e3 / 343.0
_PISTON_RINGS = 8  # 1.6 mm apart: under half a wavelength up to 100 kHz


def direct_path(
    emitter_m: FloatArray, mics_m: FloatArray, speed_of_sound_m_s: float, rng: np.random.Generator
) -> Echoes:
    """Sound straight from the emitter to microphones in the same baffle, and the housing's ringing.

    The field of a piston in its own plane is the Rayleigh integral over its face, here as a sum
    over points nearer to each other than half a wavelength; only its level is fitted.

    Parameters
    ----------
    emitter_m, mics_m : shape (3,) and (num_mics, 3)
    speed_of_sound_m_s : float
    rng
        Of the ringing.
    """
    points, weights = _piston_points()
    to_mics = np.linalg.norm(emitter_m + points[:, None, :] - mics_m[None], axis=2)
    across = np.linalg.norm(mics_m - emitter_m, axis=1)
    piston = Echoes.of(to_mics, _BESIDE * weights[:, None] / to_mics)
    return Echoes.join([piston, _ringing(across, speed_of_sound_m_s, rng)])


def _piston_points() -> tuple[FloatArray, FloatArray]:
    """Points on the piston's face, shape (n, 3), and the share of the area each stands for."""
    edges = np.linspace(0, PISTON_RADIUS_M, _PISTON_RINGS + 1)
    points, weights = [], []
    for ring, (inner, outer) in enumerate(itertools.pairwise(edges)):
        radius = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
        count = round(2 * np.pi * radius / edges[1])
        angle = 2 * np.pi * (np.arange(count) + 0.5 * (ring % 2)) / count
        points.append(
            np.column_stack([np.zeros(count), radius * np.cos(angle), radius * np.sin(angle)])
        )
        weights.append(np.full(count, (outer**2 - inner**2) / PISTON_RADIUS_M**2 / count))
    return np.concatenate(points), np.concatenate(weights)


def _ringing(across_m: FloatArray, speed_of_sound_m_s: float, rng: np.random.Generator) -> Echoes:
    """Random taps, denser at first, whose energy falls as ``RING_DOWN`` says."""
    late_s = np.sort(RING_DOWN_S * rng.random(_RING_DOWN_TAPS) ** 2)
    taps_per_ms = _RING_DOWN_TAPS / (2 * np.sqrt(RING_DOWN_S * late_s)) / 1e3
    energy_per_ms = sum(10 ** ((start - slope * late_s * 1e3) / 10) for start, slope in RING_DOWN)
    strength = _BESIDE * np.sqrt(energy_per_ms / taps_per_ms) * _REFERENCE_K**-RING_DOWN_EXPONENT
    return Echoes.of(
        across_m + late_s[:, None] * speed_of_sound_m_s,
        rng.normal(size=(_RING_DOWN_TAPS, across_m.size)) * strength[:, None],
        exponent=RING_DOWN_EXPONENT,
    )
