"""One thing that is wrong with a data set."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """What is wrong, and where.

    kind : str
        ``table``, ``missing``, ``stray``, ``unfinished``, ``hash``, ``unreadable``, ``duplicate``,
        ``leak``, ``label``, ``echo``, ``microphones``, ``silent``, ``clipped``, ``settings``,
        ``source`` or ``balance``.
    text : str
        What was met, what was expected, what to do.
    file_name : str
        The recording, or empty if it is about several.
    line : int
        In ``metadata.csv``; 0 for none.
    """

    kind: str
    text: str
    file_name: str = ""
    line: int = 0
