"""Work dealt out to processes, in order; what all items need is sent to each process once."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import get_context
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

_kept: Callable[[Any], Any] | None = None


class Workers:
    """Deals items out to ``count`` processes; with one, works in this one.

    Parameters
    ----------
    count : int
    progress : called with the number of items done and of all items
    """

    def __init__(
        self, count: int, progress: Callable[[int, int], None] = lambda done, of: None
    ) -> None:
        self.count, self.progress = count, progress

    def __call__(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Result]:
        """Yield ``function(item)`` of each item, in order."""
        results = map(function, items) if self.count == 1 else self._spread(function, items)
        for number, result in enumerate(results, 1):
            self.progress(number, len(items))
            yield result

    def _spread(
        self, function: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Result]:
        with get_context("spawn").Pool(self.count, _begin, (function,)) as pool:
            yield from pool.imap(_call, items)


def _begin(function: Callable[[Any], Any]) -> None:
    global _kept
    _kept = function
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's


def _call(item: Any) -> Any:
    assert _kept is not None  # set when the process began
    return _kept(item)
