"""A recording as the frames of an emulated sonar, over and over."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_driver.errors import RecordingError
from ertis_driver.firmware import PingRequest
from ertis_driver.frame import Source
from ertis_driver.recording import RecordedPing, open_recording

log = logging.getLogger(__name__)


class ReplaySource:
    """Cycles through a recording; implements ``FrameSource``.

    A shorter frame than was recorded is its beginning, as the sensor itself would have stopped
    listening. A longer one is refused: nobody knows what would have been heard.

    Parameters
    ----------
    path
        An MCAP recording, or headerless words.

    Raises
    ------
    RecordingError
        If it cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self._recording = open_recording(path)
        self._pings: Iterator[RecordedPing] = iter(())
        self._warned_num_words = self._recording.info.num_words

    @property
    def mark(self) -> Source:
        """What the emulator shall call itself: a recorded simulation stays one."""
        return "sim" if self._recording.info.source == "sim" else "replay"

    def next_frame(self, request: PingRequest) -> npt.NDArray[np.uint32]:
        """Return the next recorded frame: uint32, shape (request.num_words,).

        Raises
        ------
        RecordingError
            If it is shorter than asked for or of another PDM clock, or the recording is damaged or
            empty.
        """
        recorded = self._recording.info.num_words
        if request.pdm_rate_hz != self._recording.info.pdm_rate_hz:
            raise RecordingError(
                f"{self._recording.path} was recorded at {self._recording.info.pdm_rate_hz} Hz, "
                f"asked for {request.pdm_rate_hz}: configure that PDM clock"
            )
        if request.num_words > recorded:
            raise RecordingError(
                f"{self._recording.path} has frames of {recorded} words, asked for "
                f"{request.num_words}: ask for no more"
            )
        if request.num_words != self._warned_num_words:
            self._warned_num_words = request.num_words
            log.warning(
                "frames of %s cut from %d words to %d",
                self._recording.path,
                recorded,
                request.num_words,
            )
        return self._next().frame.words[: request.num_words]

    def _next(self) -> RecordedPing:
        ping = next(self._pings, None)
        if ping is None:
            self._pings = iter(self._recording)
            ping = next(self._pings, None)
        if ping is None:
            raise RecordingError(f"{self._recording.path} holds no pings: record again")
        return ping
