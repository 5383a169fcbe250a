"""Echoes as the renderer takes them: paths, gains and smooth spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Many ways from the emitter to each microphone.

    path_m : shape (num_echoes, num_mics)
        Length of the way.
    gain : shape (num_echoes, num_mics)
        Scattering and spreading: amplitude against that at 1 m, at k = 1 rad/m.
    exponent : shape (num_echoes,)
        Spectrum k**exponent.
    sin_emission : shape (num_echoes,)
        Sine of the angle off the emitter's axis; 1 also for what leaves backward.
    roughness_m : shape (num_echoes,)
        RMS height of the surfaces met, scaled by the cosine of incidence.
    """

    path_m: FloatArray
    gain: FloatArray
    exponent: FloatArray
    sin_emission: FloatArray
    roughness_m: FloatArray

    @classmethod
    def of(
        cls,
        path_m: FloatArray,
        gain: FloatArray,
        *,
        exponent: float | FloatArray = 0.0,
        sin_emission: float | FloatArray = 0.0,
        roughness_m: float = 0.0,
    ) -> Echoes:
        """One echo of shape (num_mics,), or many of shape (num_echoes, num_mics)."""
        path, gain = np.atleast_2d(path_m), np.atleast_2d(gain)

        def each(value: float | FloatArray) -> FloatArray:
            return np.broadcast_to(np.asarray(value, float), (len(path),))

        return cls(path, gain, each(exponent), each(sin_emission), each(roughness_m))

    @classmethod
    def join(cls, parts: Sequence[Echoes]) -> Echoes:
        """All echoes of all parts."""
        return cls(
            np.concatenate([part.path_m for part in parts]),
            np.concatenate([part.gain for part in parts]),
            np.concatenate([part.exponent for part in parts]),
            np.concatenate([part.sin_emission for part in parts]),
            np.concatenate([part.roughness_m for part in parts]),
        )

    def emitted(
        self, sin_emission: float, *, factor: float = 1.0, roughness_m: float = 0
    ) -> Echoes:
        """The same echoes for an emission angle, scaled, off a rough surface."""
        return Echoes(
            self.path_m,
            self.gain * factor,
            self.exponent,
            np.full(len(self.path_m), sin_emission),
            self.roughness_m + roughness_m,
        )
