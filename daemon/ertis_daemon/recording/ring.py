"""The last pings, in bounded memory."""

from __future__ import annotations

import time
from collections import deque

from ertis_driver.frame import PdmFrame


class FrameRing:
    """Keeps frames for some time, and never more bytes than allowed. Not for two threads at once.

    Parameters
    ----------
    keep_s
        How long a frame is kept, s; 0 keeps none.
    max_bytes
        Of all frames; the oldest go first.
    """

    def __init__(self, keep_s: float, max_bytes: int) -> None:
        self._keep_s = keep_s
        self._max_bytes = max_bytes
        self._bytes = 0
        self._frames: deque[tuple[float, PdmFrame]] = deque()

    @property
    def num_bytes(self) -> int:
        """Of the frames kept."""
        return self._bytes

    def append(self, frame: PdmFrame) -> None:
        """Keep a frame; forget what is too old or too much."""
        if self._keep_s <= 0:
            return
        now_s = time.monotonic()
        self._frames.append((now_s, frame))
        self._bytes += frame.words.nbytes
        self._forget(now_s)

    def newest(self, before_s: float) -> list[PdmFrame]:
        """The frames of the last ``before_s`` seconds, oldest first."""
        since_s = time.monotonic() - before_s
        return [frame for at_s, frame in self._frames if at_s >= since_s]

    def clear(self) -> None:
        """Forget all."""
        self._frames.clear()
        self._bytes = 0

    def _forget(self, now_s: float) -> None:
        while self._frames:
            at_s, oldest = self._frames[0]
            if now_s - at_s <= self._keep_s and self._bytes <= self._max_bytes:
                return
            self._frames.popleft()
            self._bytes -= oldest.words.nbytes
