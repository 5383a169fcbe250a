"""Echoes as the renderer takes them: points with smooth spectra, and bodies with any spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex64]


class Scatterer(Protocol):
    """A body that returns many echoes close together, such as a dish."""

    @property
    def path_m(self) -> FloatArray:
        """Way by way of some point of the body, shape (num_mics,)."""

    @property
    def reach_m(self) -> tuple[float, float]:
        """How far before and behind that way its echoes arrive."""

    def spectrum(self, k_rad_m: FloatArray, from_m: FloatArray | None = None) -> ComplexArray:
        """Amplitude against that at 1 m, shape (num_mics, num_k), for evenly spaced k.

        A way r turns by e^{-ikr}; ways count from ``from_m``, shape (num_mics,), or ``path_m``.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """A body as heard by one way: what the way does to its echoes.

    factor : float
        Product of the reflections on the way.
    sin_emission, roughness_m : float
        As of :class:`Echoes`.
    """

    body: Scatterer
    factor: float = 1.0
    sin_emission: float = 0.0
    roughness_m: float = 0.0


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
    responses : tuple of Response
        Bodies heard beside the echoes.
    """

    path_m: FloatArray
    gain: FloatArray
    exponent: FloatArray
    sin_emission: FloatArray
    roughness_m: FloatArray
    responses: tuple[Response, ...] = ()

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
            return np.full(len(path), value, np.float64)

        return cls(path, gain, each(exponent), each(sin_emission), each(roughness_m))

    @classmethod
    def from_body(cls, body: Scatterer) -> Echoes:
        """No point echoes, one body."""
        none = np.empty((0, body.path_m.size))
        each = np.empty(0)
        return cls(none, none, each, each, each, (Response(body),))

    @classmethod
    def join(cls, parts: Sequence[Echoes]) -> Echoes:
        """All echoes of all parts."""
        return cls(
            np.concatenate([part.path_m for part in parts]),
            np.concatenate([part.gain for part in parts]),
            np.concatenate([part.exponent for part in parts]),
            np.concatenate([part.sin_emission for part in parts]),
            np.concatenate([part.roughness_m for part in parts]),
            tuple(response for part in parts for response in part.responses),
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
            tuple(
                replace(
                    heard,
                    factor=heard.factor * factor,
                    sin_emission=sin_emission,
                    roughness_m=heard.roughness_m + roughness_m,
                )
                for heard in self.responses
            ),
        )
