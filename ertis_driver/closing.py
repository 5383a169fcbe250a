"""What is open, and closes itself at the end of a ``with``."""

from __future__ import annotations

from types import TracebackType

from typing_extensions import Self


class Closing:
    """Context manager of whatever has ``close()``."""

    __slots__ = ()

    def close(self) -> None:
        """Give back what is held. May be called twice."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Nothing but itself: it is open already."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close it."""
        self.close()
