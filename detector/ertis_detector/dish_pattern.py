"""What peaks a dish should return, and when: closed form, for any list of radii.

Four kinds of glint: the rim (its nearest and its farthest point, once the dish is turned), the
vertex, the rings of two and of three bounces. An n-bounce ring is met at incidence
``i = (pi / 2) (1 - 1 / n)``: radius R sin i, way 2 n R cos i beyond that to the sphere's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]

SPHERE_RADIUS = 17 / 15  # over aperture radius: a depth of 0.6 of it
HALF_OPENING_RAD = float(np.arcsin(1 / SPHERE_RADIUS))
GLINTS = ("near rim", "far rim", "vertex", "two-bounce ring", "three-bounce ring")
# Of a sharp edge's diffraction seen from the front, over aperture radius; a tapered rim has less.
_RIM = 0.25
_LEAST = 1e-3  # of the aperture radius: a glint in the shadow


@dataclass(frozen=True, slots=True, eq=False)
class DishPattern:
    """Expected glints of dishes, each radius at each tilt.

    delay_s : float64, shape (num_radii, num_tilts, num_glints)
        After the echo of the deepest point of the dish.
    level_db : float64, same shape
        Scattering length against 1 m.
    """

    delay_s: Float
    level_db: Float

    @classmethod
    def of(
        cls, radii_m: Float, tilts_rad: Float, frequency_hz: float, speed_of_sound_m_s: float
    ) -> DishPattern:
        """Pattern at one frequency, the middle of what is heard.

        Parameters
        ----------
        radii_m : shape (num_radii,)
            Of the apertures.
        tilts_rad : shape (num_tilts,)
            Between axis and line of sight.
        frequency_hz, speed_of_sound_m_s : float
        """
        ka = 2 * np.pi * frequency_hz / speed_of_sound_m_s * radii_m
        ways = np.array([_ways(tilt) for tilt in tilts_rad])
        delay = radii_m[:, None, None] * ways[None] / speed_of_sound_m_s
        length = np.array([[_lengths(size, tilt) for tilt in tilts_rad] for size in ka])
        level = 20 * np.log10(radii_m[:, None, None] * np.maximum(length, _LEAST))
        return cls(delay, level)


def _ways(tilt_rad: float) -> list[float]:
    """Ways of all glints beyond that by the deepest point, in aperture radii."""
    sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
    to_rim_plane = SPHERE_RADIUS * np.cos(HALF_OPENING_RAD)
    own = 2 * SPHERE_RADIUS * cosine  # by the deepest point, beyond the sphere's centre
    rim = [2 * (to_rim_plane * cosine + side * sine) for side in (-1, 1)]
    rings = [2 * n * SPHERE_RADIUS * np.cos(_incidence(n)) for n in (2, 3)]
    return [way - own for way in (*rim, 2 * SPHERE_RADIUS, *rings)]


def _lengths(ka: float, tilt_rad: float) -> list[float]:
    """Scattering lengths of all glints, in aperture radii."""
    spread = 2 * ka * np.sin(tilt_rad)  # two points of the rim take the place of a ring in phase
    rim = _RIM * min(0.5, 1 / np.sqrt(2 * np.pi * max(spread, 1e-9)))
    vertex = SPHERE_RADIUS / 2 if tilt_rad < HALF_OPENING_RAD else 0.0
    return [rim, rim, vertex, *(_ring_length(n, ka, tilt_rad) for n in (2, 3))]


def _incidence(bounces: int) -> float:
    return float(np.pi / 2 * (1 - 1 / bounces))


def _ring_length(bounces: int, ka: float, tilt_rad: float) -> float:
    """``b sqrt(2 pi k R cos i / (2 n))`` times the part of the ring that is lit."""
    i = _incidence(bounces)
    width = SPHERE_RADIUS * np.sin(i)
    over = np.cos(tilt_rad) * np.cos(i) - np.cos(HALF_OPENING_RAD)
    across = max(np.sin(tilt_rad) * np.sin(i), 1e-9)
    lit = max(2 / np.pi * np.arcsin(np.clip(over / across, -1, 1)), 0.0)
    return float(width * np.sqrt(np.pi * ka * SPHERE_RADIUS * np.cos(i) / bounces) * lit)
