"""A recording as the frames of an emulated sonar."""

from __future__ import annotations

import logging
import threading
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_driver.errors import EndOfRecording, RecordingError
from ertis_driver.firmware import PingRequest
from ertis_driver.frame import Source
from ertis_driver.recording import RecordedPing, Recording, open_recording
from ertis_driver.replay_pace import ReplayPace

log = logging.getLogger(__name__)


class ReplaySource:
    """Plays a recording, over and over or once; implements ``FrameSource``.

    A shorter frame than was recorded is its beginning, as the sensor itself would have stopped
    listening. A longer one is refused: nobody knows what would have been heard.

    Parameters
    ----------
    path
        An MCAP recording, or headerless words.
    rate : float or None
        1 keeps the recording's own pace: a ping is answered no sooner than it is due. None answers
        at once.
    loop
        Begin again after the last ping.
    stop
        Set it to end a wait for a ping; it is set here once there are no more.

    Raises
    ------
    RecordingError
        If it cannot be read.
    SettingsError
        If there is no such rate.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        rate: float | None = None,
        loop: bool = True,
        stop: threading.Event | None = None,
    ) -> None:
        self._recording = open_recording(path)
        self._pace = ReplayPace(self._recording, rate=rate, loop=loop)
        self._loop = loop
        self._stop = stop or threading.Event()
        self._warned_num_words = self._recording.info.num_words

    @property
    def recording(self) -> Recording:
        """What is played."""
        return self._recording

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
        EndOfRecording
            After the last, unless it loops.
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
        ping = self._pace.wait(self._stop)
        if ping is not None:
            return ping
        if self._loop and not self._stop.is_set():
            raise RecordingError(f"{self._recording.path} holds no pings: record again")
        self._stop.set()
        raise EndOfRecording(f"{self._recording.path} has no more pings")
