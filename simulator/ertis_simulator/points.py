"""Points that scatter, each with a strength, a spectrum and perhaps a facing: glints of clutter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.path import Pose

FloatArray = npt.NDArray[np.float64]

REFERENCE_K = 2 * np.pi * 50e3 / 343.0  # strengths are stated at 50 kHz
ALL_ROUND_RAD = 1e3  # a lobe so wide that it is none
_NEAREST_M2 = 0.04  # out times back: nearer, a point is no model of anything


@dataclass(frozen=True, slots=True, eq=False)
class Points:
    """Points in the world.

    positions_m : shape (n, 3)
    lengths_m : shape (n,)
        Scattering length at 50 kHz, signed.
    exponents : shape (n,)
        Spectrum f**exponent: -0.5 edge, 0 point-like curved face, 1 flat or corner.
    facing_rad : shape (n, 2)
        Azimuth and elevation of the strongest return, world frame.
    lobe_rad : shape (n, 2)
        Half-width of that lobe, across and up: at it, the amplitude is down by 3 dB.
    """

    positions_m: FloatArray
    lengths_m: FloatArray
    exponents: FloatArray
    facing_rad: FloatArray
    lobe_rad: FloatArray

    @classmethod
    def all_round(
        cls, positions_m: FloatArray, lengths_m: FloatArray, exponents: FloatArray
    ) -> Points:
        """Points that look the same from everywhere."""
        n = len(positions_m)
        return cls(
            positions_m, lengths_m, exponents, np.zeros((n, 2)), np.full((n, 2), ALL_ROUND_RAD)
        )

    @classmethod
    def none(cls) -> Points:
        """No glint at all."""
        return cls.all_round(np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    @classmethod
    def join(cls, parts: list[Points]) -> Points:
        """All glints of all parts."""
        return cls(
            np.concatenate([part.positions_m for part in parts]),
            np.concatenate([part.lengths_m for part in parts]),
            np.concatenate([part.exponents for part in parts]),
            np.concatenate([part.facing_rad for part in parts]),
            np.concatenate([part.lobe_rad for part in parts]),
        )

    def where(self, keep: npt.NDArray[np.bool_]) -> Points:
        """Those for which ``keep``, shape (n,), is true."""
        return Points(
            self.positions_m[keep],
            self.lengths_m[keep],
            self.exponents[keep],
            self.facing_rad[keep],
            self.lobe_rad[keep],
        )

    def shifted(self, offset_m: FloatArray) -> Points:
        """The same glints elsewhere."""
        return Points(
            self.positions_m + offset_m,
            self.lengths_m,
            self.exponents,
            self.facing_rad,
            self.lobe_rad,
        )

    def echoes(self, pose: Pose, emitter: FloatArray, mics: FloatArray) -> Echoes:
        """Their echoes; emitter (3,) and mics (num_mics, 3) in the sensor frame."""
        at_m = pose.to_sensor(self.positions_m)
        out = at_m - emitter
        there = np.linalg.norm(out, axis=1)
        back = np.linalg.norm(at_m[:, None, :] - mics[None], axis=2)
        near = np.maximum(there[:, None] * back, _NEAREST_M2)
        sine = np.where(out[:, 0] > 0, np.hypot(out[:, 1], out[:, 2]) / there, 1.0)
        strength = self.lengths_m * self._lobe(pose) / REFERENCE_K**self.exponents
        return Echoes.of(
            there[:, None] + back,
            strength[:, None] / near,
            exponent=self.exponents,
            sin_emission=sine,
        )

    def _lobe(self, pose: Pose) -> FloatArray:
        toward = np.asarray(pose.position_m) - self.positions_m
        azimuth = np.arctan2(toward[:, 1], toward[:, 0])
        elevation = np.arctan2(toward[:, 2], np.hypot(toward[:, 0], toward[:, 1]))
        off = np.stack([azimuth, elevation], axis=1) - self.facing_rad
        off = (off + np.pi) % (2 * np.pi) - np.pi
        return np.asarray(2 ** (-0.5 * np.sum((off / self.lobe_rad) ** 2, axis=1)))
