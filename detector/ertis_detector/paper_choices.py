"""What the paper leaves open, each with the default that docs/decisions/0006 argues."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from ertis_detector.errors import EvaluationError

_ALLOWED: Mapping[str, tuple[str, ...]] = {
    "taper": ("hann", "hamming", "tukey", "none"),
    "sound": ("raw", "compressed"),
    "placing": ("arrival", "middle"),
    "magnitude": ("linear", "power", "db"),
    "binning": ("mean", "point"),
    "spreading": ("kept", "undone"),
    "scaling": ("standard", "minmax", "unit", "none"),
    "stages": ("two", "one"),
    "weighting": ("none", "balanced"),
}
_MICROPHONE_WORDS = ("mean", "sum", "beam")


@dataclass(frozen=True, slots=True)
class PaperChoices:
    """The paper's pipeline, with a name for everything that its text does not settle.

    microphone : str
        ``mean`` of all microphones' magnitudes; ``sum`` of their sound; ``beam`` of it toward the
        labelled azimuth (which the paper was not told); or one microphone's number.
    sound : str
        ``raw``, or ``compressed`` by the chirp's matched filter before it is cropped.
    placing : str
        What lies in the fragment's middle: the echo's ``arrival``, or its ``middle``, half a chirp
        later. The same for compressed sound, where an echo is short.
    taper : str
        ``hann``, ``hamming``, ``tukey`` (half of it flat) or ``none``.
    filter_order : int
        Of the Butterworth band-pass, once forward; 0 leaves it out.
    magnitude : str
        ``linear``, its square (``power``), or decibels.
    binning : str
        ``mean`` of the FFT's lines in each of the bins, or the line nearest to each of as many
        ``point`` frequencies, both ends of the band included.
    num_bins : int
        20 in the paper.
    spreading : str
        ``kept``, or ``undone`` by range squared.
    scaling : str
        ``standard`` (each feature's mean and spread over the pings that are learnt from),
        ``minmax`` (to 0 ... 1 likewise), ``unit`` (each vector to length 1, then standard), or
        ``none``.
    penalty : float
        C of the SVM.
    stages : str
        ``two``: landmark or not, then which; ``one``: all labels and ``none`` in one vote.
    weighting : str
        ``none``, or ``balanced``: rare labels' errors cost more.

    Raises
    ------
    EvaluationError
        For a value that is none of these.
    """

    microphone: str = "mean"
    sound: str = "raw"
    placing: str = "arrival"
    taper: str = "hann"
    filter_order: int = 4
    magnitude: str = "linear"
    binning: str = "mean"
    num_bins: int = 20
    spreading: str = "kept"
    scaling: str = "standard"
    penalty: float = 1.0
    stages: str = "two"
    weighting: str = "none"

    def __post_init__(self) -> None:
        for name, allowed in _ALLOWED.items():
            value = getattr(self, name)
            if value not in allowed:
                raise EvaluationError(f"{name} {value!r}, expected one of {', '.join(allowed)}")
        if self.microphone not in _MICROPHONE_WORDS and not self.microphone.isdecimal():
            words = ", ".join(_MICROPHONE_WORDS)
            raise EvaluationError(f"microphone {self.microphone!r}, expected {words} or a number")
        for name, low, high in (
            ("filter_order", 0, 10),
            ("num_bins", 2, 128),
            ("penalty", 1e-6, 100),
        ):
            if not low <= getattr(self, name) <= high:
                raise EvaluationError(
                    f"{name} {getattr(self, name)!r}, expected {low:g} to {high:g}"
                )

    def changed(self, assignments: Sequence[str]) -> PaperChoices:
        """With ``name=value`` assignments applied.

        Raises
        ------
        EvaluationError
            If a name or value does not exist.
        """
        values: dict[str, Any] = {}
        known = {one.name: type(getattr(self, one.name)) for one in dataclasses.fields(self)}
        for text in assignments:
            name, equals, value = text.partition("=")
            if name not in known or not equals:
                near = get_close_matches(name, known, 1)
                hint = f", did you mean {near[0]}?" if near else f" of {', '.join(known)}"
                raise EvaluationError(f"choice {text!r}, expected NAME=VALUE{hint}")
            try:
                values[name] = known[name](value)
            except ValueError as error:
                raise EvaluationError(f"choice {text!r}: expected a number") from error
        return dataclasses.replace(self, **values)

    @property
    def preparation(self) -> PaperChoices:
        """These choices without those that matter only once pings are prepared."""
        plain = PaperChoices()
        return dataclasses.replace(
            self,
            scaling=plain.scaling,
            penalty=plain.penalty,
            stages=plain.stages,
            weighting=plain.weighting,
        )

    def difference(self, other: PaperChoices) -> str:
        """What is chosen otherwise than in ``other``, as ``name=value`` text."""
        return ", ".join(
            f"{one.name}={getattr(self, one.name)}"
            for one in dataclasses.fields(self)
            if getattr(self, one.name) != getattr(other, one.name)
        )


# What the text leaves open, one at a time; the sweep's table.
ALTERNATIVES: Mapping[str, tuple[str, ...]] = {
    "microphone": ("0", "16", "sum", "beam"),
    "sound": ("compressed",),
    "placing": ("middle",),
    "taper": ("tukey", "hamming", "none"),
    "filter_order": ("0", "8"),
    "magnitude": ("power", "db"),
    "binning": ("point",),
    "num_bins": ("10", "64"),
    "spreading": ("undone",),
    "scaling": ("unit", "minmax", "none"),
    "penalty": ("0.1", "10"),
    "stages": ("one",),
    "weighting": ("balanced",),
}


def alternatives(default: PaperChoices) -> list[PaperChoices]:
    """Every choice that differs from ``default`` in one thing."""
    found = [
        default.changed([f"{name}={value}"])
        for name, values in ALTERNATIVES.items()
        for value in values
    ]
    return [one for one in found if one != default]
