"""How long a sonar in trouble is left alone before it is opened again."""

from __future__ import annotations


class Backoff:
    """Twice as long each time, up to 8 s; trouble now and then, with work between, is no more."""

    FIRST_S, LAST_S = 0.5, 8.0

    def __init__(self) -> None:
        self._next_s = self.FIRST_S

    def reset(self) -> None:
        """Begin anew."""
        self._next_s = self.FIRST_S

    def after(self, worked_s: float) -> float:
        """The pause now, s, after the sonar worked for so long."""
        if worked_s > self.LAST_S:
            self.reset()
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self.LAST_S)
        return pause_s
