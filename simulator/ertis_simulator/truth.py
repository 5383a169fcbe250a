"""What is there, seen from the sonar: the truth that simulated recordings carry."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.objects import DishObject
from ertis_simulator.path import Pose

FloatArray = npt.NDArray[np.float64]

VISIBLE_TILT_RAD = np.deg2rad(35.0)  # beyond it only rim and vertex are left: "limiting angle"
VISIBLE_RANGE_M = 0.6  # nearer, the ring-down covers it
VISIBLE_AZIMUTH_RAD = np.deg2rad(25.0)  # the emitter's beam has its first null at 19 (50 kHz)
SHADOWED_PART = 0.5  # less than that of the aperture in sight is called shadowed
FRAGMENT_SAMPLES = 1024  # the paper's: 39 cm of range


def seen_dish(item: DishObject, vertex_m: FloatArray, pose: Pose, clear: float) -> dict[str, Any]:
    """Truth of one dish.

    Parameters
    ----------
    vertex_m : shape (3,)
        World frame, now.
    clear : float
        Part of its aperture that nothing hides.
    """
    at = pose.to_sensor(vertex_m)
    distance = float(np.linalg.norm(at))
    # A sonar in the very vertex sees no side of it.
    tilt = float(np.arccos(np.clip(pose.turn(item.axis) @ (-at / max(distance, 1e-9)), -1, 1)))
    azimuth = float(np.arctan2(at[1], at[0]))
    shadowed = clear < SHADOWED_PART
    visible = bool(
        tilt < VISIBLE_TILT_RAD
        and abs(azimuth) < VISIBLE_AZIMUTH_RAD
        and distance > VISIBLE_RANGE_M
        and not shadowed
    )
    return {
        "label": item.label,
        **_place(at),
        "tilt_rad": round(tilt, 5),
        "radius_m": item.dish.aperture_radius_m,
        "clear_part": round(clear, 3),
        "shadowed": shadowed,
        "visible": visible,
    }


def seen_thing(kind: str, place_m: FloatArray, pose: Pose) -> dict[str, Any]:
    """Truth of anything else, at its middle."""
    return {"label": kind, **_place(pose.to_sensor(place_m))}


def _place(at_m: FloatArray) -> dict[str, float]:
    x, y, z = at_m
    return {
        "range_m": round(float(np.linalg.norm(at_m)), 5),
        "azimuth_rad": round(float(np.arctan2(y, x)), 5),
        "elevation_rad": round(float(np.arctan2(z, np.hypot(x, y))), 5),
    }


def fragment_span(range_m: float, speed_m_s: float) -> tuple[int, int]:
    """First audio sample of the fragment around a range, and the one after its last."""
    first = round(2 * range_m / speed_m_s * AUDIO_RATE_HZ) - FRAGMENT_SAMPLES // 2
    return first, first + FRAGMENT_SAMPLES


def own_to_rest_db(
    own: npt.NDArray[np.float32],
    total: npt.NDArray[np.float32],
    chirp: FloatArray,
    fragment: tuple[int, int],
) -> float | None:
    """Energy of one echo against that of all else in its fragment, after compression.

    Parameters
    ----------
    own, total : float32, shape (num_mics, num_samples)
        Pressure with that echo alone, and with everything, noise included.
    chirp : float64, shape (n,)
    fragment : (first, stop)
        As from ``fragment_span``.

    Returns
    -------
    float or None
        dB; None if the fragment lies outside the ping, or nothing of it is heard.
    """
    first, stop = fragment
    if first < 0 or stop > own.shape[1]:
        return None
    energies = []
    for pressure in (own, total - own):
        heard = pressure[:, first : stop + chirp.size]
        size = scipy.fft.next_fast_len(heard.shape[1] + chirp.size, real=True)
        spectrum = scipy.fft.rfft(heard, size, axis=1) * np.conj(scipy.fft.rfft(chirp, size))
        compressed = scipy.fft.irfft(spectrum, size, axis=1)[:, :FRAGMENT_SAMPLES]
        energies.append(float(np.sum(compressed.astype(np.float64) ** 2)))
    if energies[0] == 0.0:
        return None
    return round(float(10 * np.log10(energies[0] / max(energies[1], 1e-30))), 2)
