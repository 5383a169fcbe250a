"""How often things that are no landmark are believed to be one, and how firmly: measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ertis_detector.errors import DetectorError

_TAIL, _LEAST_TAIL = 1 / 8, 20  # the highest of all, which tell the slope to a fifth at least
LEAST_TRACKS = 2 * _LEAST_TAIL
_NAMES = "false_tracks_per_ping", "false_tracks_fade"  # on a model's card


@dataclass(frozen=True, slots=True)
class FalseTracks:
    """Tracks of no landmark whose evidence ever passes ``t`` nats: ``exp(-fade t)`` of some.

    Were evidence exact and views as alike as assumed, ``fade`` would be 1 at least (Ville 1939);
    more is not believed. It is less where what misleads once goes on to do so.

    per_ping : float
        Tracks a ping that pass 0 nats, by that law.
    fade : float
        1 / nats.
    """

    per_ping: float
    fade: float

    @classmethod
    def of(cls, peaks: Sequence[float], pings: int) -> FalseTracks:
        """Most likely law of the highest peaks, of drives without a landmark.

        Parameters
        ----------
        peaks : sequence of float
            The most that each track was ever believed, nats.
        pings : int
            Heard in all.

        Raises
        ------
        DetectorError
            If there are fewer tracks than ``LEAST_TRACKS``.
        """
        if len(peaks) < LEAST_TRACKS:
            raise DetectorError(
                f"{len(peaks)} things were taken for landmarks at all in {pings} pings of drives, "
                f"expected {LEAST_TRACKS}: drive for longer"
            )
        ranked = sorted(peaks, reverse=True)
        count = max(int(_TAIL * len(ranked)), _LEAST_TAIL)
        level = ranked[count]
        excess = math.fsum(ranked[:count]) / count - level
        fade = 1.0 / max(excess, 1.0)
        return cls(count / pings * math.exp(fade * level), fade)

    @classmethod
    def from_figures(cls, figures: Mapping[str, float]) -> FalseTracks | None:
        """Of a model's card; None if it has none, or nonsense."""
        values = [figures.get(name, math.nan) for name in _NAMES]
        if not all(isinstance(v, (int, float)) and 0 < v < math.inf for v in values):
            return None
        return cls(*values)

    def figures(self) -> dict[str, float]:
        """For a model's card."""
        return dict(zip(_NAMES, (round(self.per_ping, 6), round(self.fade, 4)), strict=True))

    def level(self, per_ping: float) -> float:
        """Evidence, nats, that so many tracks a ping pass."""
        return math.log(self.per_ping / per_ping) / self.fade
