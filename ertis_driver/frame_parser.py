"""Frames out of a stream of bytes that may hold rubbish. Pure; no ports here."""

from __future__ import annotations

from ertis_driver.protocol import (
    FOOTER_BYTES,
    HEADER_BYTES,
    Bytes,
    RawFrame,
    decode_frame,
    frame_bytes,
)


class FrameParser:
    """Finds frames of one size in a byte stream.

    A header is believed only when the footer stands where it must; otherwise the search goes on
    one byte further, so a frame cut short costs itself and never the one behind it.

    Parameters
    ----------
    num_words
        PDM words in a frame: the wire does not say, the device was told.

    Attributes
    ----------
    bytes_lost : int
        Bytes that belonged to no frame.
    frames_corrupt : int
        Headers whose footer was wrong.
    """

    def __init__(self, num_words: int) -> None:
        self.num_words = num_words
        self.bytes_lost = 0
        self.frames_corrupt = 0
        self._size = frame_bytes(num_words)
        # Twice the frame: what is left is moved to the front at most once a frame, so cost stays
        # linear however finely the stream is cut.
        self._buffer = bytearray(2 * self._size)
        self._start = 0
        self._end = 0

    @property
    def pending_bytes(self) -> int:
        """Bytes held that are not a whole frame yet."""
        return self._end - self._start

    def feed(self, data: Bytes) -> list[RawFrame]:
        """Take bytes as they come, return the frames that they complete."""
        frames: list[RawFrame] = []
        view = memoryview(data).cast("B")
        while len(view):
            if self._end == len(self._buffer):
                self._move_to_front()
            count = min(len(view), len(self._buffer) - self._end)
            self._buffer[self._end : self._end + count] = view[:count]
            self._end += count
            view = view[count:]
            self._take(frames)
        return frames

    def clear(self) -> int:
        """Forget what is held; return how many bytes that was (counted as lost)."""
        count = self.pending_bytes
        self._drop_until(self._end)
        return count

    def _move_to_front(self) -> None:
        count = self.pending_bytes
        self._buffer[:count] = self._buffer[self._start : self._end]
        self._start, self._end = 0, count

    def _drop_until(self, position: int) -> None:
        self.bytes_lost += position - self._start
        self._start = position

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
            if self._buffer[stop - len(FOOTER_BYTES) : stop] == FOOTER_BYTES:
                with memoryview(self._buffer) as view:
                    frames.append(decode_frame(view[header:stop]))
                self._start = stop
            else:
                self.frames_corrupt += 1
                self._drop_until(header + 1)
