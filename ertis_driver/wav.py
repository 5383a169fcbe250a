"""Audio of many channels as WAV, or as RF64 once it is larger than WAV can say (EBU Tech 3306)."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import IO

import numpy as np
import numpy.typing as npt

from ertis_driver.closing import Closing
from ertis_driver.errors import RecordingError

MAX_RIFF_BYTES = 2**32 - 1
_EXTENSIBLE, _BITS = 0xFFFE, 32
_FLOAT_GUID = bytes.fromhex("0300000000001000800000aa00389b71")  # KSDATAFORMAT_SUBTYPE_IEEE_FLOAT
_DS64 = struct.Struct("<4sIQQQI")  # also the size of what is kept free for it
_UNKNOWN = 0xFFFFFFFF


class WavWriter(Closing):
    """Writes float32 samples, block after block.

    Parameters
    ----------
    path
        A new file: nothing is overwritten.
    num_channels : int
    rate_hz : int
    comment : str
        Where it comes from; stands in the file.
    max_riff_bytes
        A larger file becomes RF64.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        num_channels: int,
        rate_hz: int,
        *,
        comment: str = "",
        max_riff_bytes: int = MAX_RIFF_BYTES,
    ) -> None:
        self.path = path
        self._channels, self._rate_hz, self._comment = num_channels, rate_hz, comment
        self._max_riff_bytes = max_riff_bytes
        self._frames = 0
        try:
            self._file: IO[bytes] = path.open("xb")
            self._file.write(self._head())
        except FileExistsError as error:
            raise RecordingError(f"{path} exists: name another file, or remove it") from error
        except OSError as error:
            raise self._failed(error) from error

    def write(self, audio: npt.NDArray[np.float32]) -> None:
        """Add a block, shape (num_channels, num_samples).

        Raises
        ------
        RecordingError
            If it has another number of channels, or the disk does not take it.
        """
        if audio.ndim != 2 or audio.shape[0] != self._channels:
            raise RecordingError(
                f"{self.path}: audio of shape {audio.shape}, expected {self._channels} channels"
            )
        try:
            self._file.write(np.ascontiguousarray(audio.T, "<f4").data)
        except OSError as error:
            raise self._failed(error) from error
        self._frames += audio.shape[1]

    def close(self) -> None:
        """Write what is only known now, and close the file. May be called twice.

        Raises
        ------
        RecordingError
            If the disk does not take it.
        """
        if self._file.closed:
            return
        try:
            with self._file:
                self._file.write(self._tail())
                size = self._file.tell()
                self._file.seek(0)
                self._file.write(self._head(size))
        except OSError as error:
            raise self._failed(error) from error

    def _head(self, size: int = 0) -> bytes:
        """All before the samples; the same length whatever it says."""
        frame_bytes = 4 * self._channels
        data_bytes = self._frames * frame_bytes
        riff_bytes = max(size - 8, 0)
        is_large = riff_bytes > self._max_riff_bytes
        large = _DS64.pack(b"ds64", _DS64.size - 8, riff_bytes, data_bytes, self._frames, 0)
        small = struct.pack("<4sI", b"JUNK", _DS64.size - 8) + bytes(_DS64.size - 8)
        kind, said = (b"RF64", _UNKNOWN) if is_large else (b"RIFF", riff_bytes)
        riff = struct.pack("<4sI4s", kind, said, b"WAVE")
        rate, channels = self._rate_hz, self._channels
        rates = (rate, rate * frame_bytes, frame_bytes, _BITS)
        fmt = struct.pack("<4sIHHIIHH", b"fmt ", 40, _EXTENSIBLE, channels, *rates)
        fmt += struct.pack("<HHI", 22, _BITS, 0) + _FLOAT_GUID
        fact = struct.pack("<4sII", b"fact", 4, min(self._frames, _UNKNOWN))
        data = struct.pack("<4sI", b"data", _UNKNOWN if is_large else data_bytes)
        return riff + (large if is_large else small) + fmt + fact + data

    def _tail(self) -> bytes:
        text = self._comment.encode("utf-8") + b"\0"
        text += bytes(len(text) % 2)
        info = b"INFO" + struct.pack("<4sI", b"ICMT", len(text)) + text
        return struct.pack("<4sI", b"LIST", len(info)) + info

    def _failed(self, error: OSError) -> RecordingError:
        return RecordingError(f"cannot write {self.path}: {error.strerror}")
