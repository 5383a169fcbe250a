"""How long a sonar in trouble is left alone before it is opened again."""

from __future__ import annotations


class Backoff:
    """Twice as long each time, up to a limit; trouble with work between is no more of it.

    Parameters
    ----------
    first_s, last_s
        The shortest pause and the longest, s. Work for longer than that begins it anew.
    """

    def __init__(self, first_s: float = 0.5, last_s: float = 8.0) -> None:
        self._first_s, self._last_s = first_s, last_s
        self._next_s = first_s

    def reset(self) -> None:
        """Begin anew."""
        self._next_s = self._first_s

    def after(self, worked_s: float) -> float:
        """The pause now, s, after the sonar worked for so long."""
        if worked_s > self._last_s:
            self.reset()
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._last_s)
        return pause_s
