"""Frames out of a stream of bytes that may hold rubbish. Pure; no ports here.

The wire has no checksum. A frame is believed if

- header and footer stand exactly one frame size apart,
- no later frame begins inside it (a header with a following index): it was cut short, and what
  looks like its end belongs to that one,
- and, if bytes were lost before it, its index may come next, or follows one refused just before.

What nothing on the wire can tell: bits flipped in the payload or, by little, in the index; as many
bytes inserted as lost within one frame; a frame's beginning and a later one's end with exactly one
frame's bytes missing between them (only where frames come unasked, back to back).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ertis_driver.ping_counter import GAP_ALLOWANCE
from ertis_driver.protocol import (
    FOOTER_BYTES,
    HEADER,
    HEADER_BYTES,
    INDEX_MODULUS,
    Bytes,
    RawFrame,
    decode_frame,
    decode_reply,
    frame_bytes,
)

# The header as two pairs of bytes, and as the pair in its middle with a byte on either side.
_FIRST_PAIR, _LAST_PAIR = HEADER & 0xFFFF, HEADER >> 16
_FIRST_BYTE, _MIDDLE_PAIR, _LAST_BYTE = HEADER & 0xFF, HEADER >> 8 & 0xFFFF, HEADER >> 24


class FrameParser:
    """Finds frames of one size in a byte stream.

    A header that is not believed costs one byte: the search goes on behind it, so a damaged frame
    costs itself and at most one more.

    Parameters
    ----------
    num_words
        PDM words in a frame: the wire does not say, the device was told.
    plausible
        Whether a frame of this index may come next; asked only after bytes were lost.

    Raises
    ------
    ValueError
        If frames of ``num_words`` cannot be.

    Attributes
    ----------
    bytes_lost : int
        Bytes that belonged to no frame.
    frames_corrupt : int
        Headers that were not believed. In a damaged frame one in 30,000 random payloads of the
        default size holds a second one.
    starts : list of int
        Where in all that was fed the frames began that the last ``feed`` or ``flush`` returned.
    """

    def __init__(self, num_words: int, plausible: Callable[[int], bool] = lambda _: True) -> None:
        if num_words < 1:
            raise ValueError(f"frames of {num_words} PDM words, expected 1 at least")
        self.num_words = num_words
        self.bytes_lost = 0
        self.frames_corrupt = 0
        self.starts: list[int] = []
        self._bytes_taken = 0
        self._plausible = plausible
        self._size = frame_bytes(num_words)
        # Twice the frame: what is left is moved to the front at most once a frame, so cost stays
        # linear however finely the stream is cut.
        self._buffer = bytearray(2 * self._size)
        self._view = memoryview(self._buffer)
        self._start = 0
        self._end = 0
        self._in_sync = True  # nothing was lost since the last frame
        self._follows_refused: int | None = None  # index that confirms one refused

    @property
    def pending_bytes(self) -> int:
        """Bytes held that are not a whole frame yet."""
        return self._end - self._start

    def feed(self, data: Bytes) -> list[RawFrame]:
        """Take bytes as they come, return the frames that they complete."""
        frames: list[RawFrame] = []
        starts: list[int] = []
        view = memoryview(data).cast("B")
        while len(view):
            room = self.room()
            count = min(len(view), len(room))
            room[:count] = view[:count]
            view = view[count:]
            frames += self.took(count)
            starts += self.starts
        self.starts = starts
        return frames

    def room(self) -> memoryview:
        """Where the next bytes may be put, to be ``took``: as many as a frame still lacks."""
        if self._start == self._end:
            self._start = self._end = 0
        lacking = self._size - self.pending_bytes
        if self._end + lacking > len(self._buffer):
            self._move_to_front()
        return self._view[self._end : self._end + lacking]

    def took(self, count: int) -> list[RawFrame]:
        """So many bytes were put into the ``room``: return the frames that they complete."""
        frames: list[RawFrame] = []
        self.starts = []
        self._end += count
        self._take(frames)
        return frames

    def flush(self) -> list[RawFrame]:
        """Nothing more will come: return frames behind headers that wait for more, drop the rest.

        The rest is counted as lost, an unfinished frame as corrupt.
        """
        frames: list[RawFrame] = []
        self.starts = []
        while self.pending_bytes >= len(HEADER_BYTES):
            if self._buffer.startswith(HEADER_BYTES, self._start):
                self._refuse(self._start)
            self._take(frames)
        self.clear()
        return frames

    def clear(self) -> int:
        """Forget what is held; return how many bytes that was (counted as lost)."""
        count = self.pending_bytes
        self._drop_until(self._end)
        self._in_sync = True
        return count

    def _move_to_front(self) -> None:
        count = self.pending_bytes
        self._buffer[:count] = self._buffer[self._start : self._end]
        self._start, self._end = 0, count

    def _drop_until(self, position: int) -> None:
        if position > self._start:
            self._in_sync = False
        self.bytes_lost += position - self._start
        self._start = position

    def _refuse(self, header: int) -> None:
        self.frames_corrupt += 1
        self._drop_until(header + 1)

    def _take(self, frames: list[RawFrame]) -> None:
        while True:
            header = self._buffer.find(HEADER_BYTES, self._start, self._end)
            if header < 0:
                # The last three bytes may be the beginning of a header.
                self._drop_until(max(self._start, self._end - len(HEADER_BYTES) + 1))
                return
            self._drop_until(header)
            stop = header + self._size
            if stop > self._end:
                return
            if self._believable(header, stop):
                frames.append(decode_frame(self._view[header:stop]))
                self.starts.append(self.bytes_lost + self._bytes_taken)
                self._bytes_taken += self._size
                self._start = stop
                self._in_sync = True
                self._follows_refused = None
            else:
                self._refuse(header)

    def _believable(self, header: int, stop: int) -> bool:
        if self._buffer[stop - len(FOOTER_BYTES) : stop] != FOOTER_BYTES:
            return False
        index = self._index_at(header)
        if self._frame_begins_within(header, stop, index):
            return False
        if self._in_sync or self._plausible(index) or index == self._follows_refused:
            return True
        self._follows_refused = (index + 1) % INDEX_MODULUS
        return False

    def _frame_begins_within(self, header: int, stop: int, index: int) -> bool:
        if not _holds_header(self._view[header + 4 : stop]):
            return False
        inner = header
        while True:
            inner = self._buffer.find(HEADER_BYTES, inner + 4, stop)
            if inner < 0 or inner + 8 > self._end:
                return False
            if 0 < (self._index_at(inner) - index) % INDEX_MODULUS <= GAP_ALLOWANCE:
                return True

    def _index_at(self, header: int) -> int:
        return decode_reply(self._buffer[header + 4 : header + 8])


def _holds_header(data: memoryview) -> bool:
    """Whether a header stands anywhere in an even number of bytes; five times as fast as ``find``.

    At an even place it is two pairs of bytes, at an odd one there is a pair in its middle.
    """
    pairs = np.frombuffer(data, "<u2")
    first = np.flatnonzero(pairs[:-1] == _FIRST_PAIR)
    if (pairs[first + 1] == _LAST_PAIR).any():
        return True
    middle = np.flatnonzero(pairs[1:-1] == _MIDDLE_PAIR) + 1
    before, after = pairs[middle - 1] >> 8, pairs[middle + 1] & 0xFF
    return bool(((before == _FIRST_BYTE) & (after == _LAST_BYTE)).any())
