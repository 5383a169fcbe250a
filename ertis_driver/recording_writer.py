"""Writes recordings: pings, events and what viewers are shown, as they come."""

from __future__ import annotations

import json
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ertis_driver import foxglove
from ertis_driver.closing import Closing
from ertis_driver.codec import PLAIN, PLANES, encode_recorded
from ertis_driver.errors import RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.mcap_writer import McapWriter, Outgoing
from ertis_driver.recording_channels import (
    FRAME_ID,
    landmark_points,
    layout_messages,
    make_channels,
)
from ertis_driver.recording_info import (
    CREATED_BY,
    METADATA,
    METADATA_COPY,
    RecordingInfo,
    to_strings,
)


class RecordingWriter(Closing):
    """Writes an MCAP recording, ping by ping; what is written survives the writer's death.

    Threads may share it. A ping is one chunk, which has left the process when ``write`` returns:
    a kill then costs nothing, a loss of power what was not yet synchronised.

    Parameters
    ----------
    path
        A new file: nothing is overwritten.
    info
        Who makes the recording, and how.
    compress
        Frames take a third less, and 10 ms of a core each.
    sync_period_s
        How often to have the disk take what was written, so that a loss of power costs no more than
        this; a thread waits for it. 0 waits after each ping; None leaves it to the system.
    event_schema
        JSON Schema of what ``write_event`` takes.

    Raises
    ------
    RecordingError
        If the file exists or cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        info: RecordingInfo,
        *,
        compress: bool = False,
        sync_period_s: float | None = None,
        event_schema: bytes = b'{"type": "object"}',
    ) -> None:
        self.path = Path(path)
        self.info = info
        self.pings_written = 0
        self._encoding = PLANES if compress else PLAIN
        self._sync_period_s = sync_period_s
        self._synced_s = time.monotonic()
        self._syncing: threading.Thread | None = None
        self._sync_error: RecordingError | None = None
        self._sequences: Counter[str] = Counter()
        self._lock = threading.RLock()
        self._mcap = McapWriter(self.path, CREATED_BY)
        try:
            self._channels = make_channels(
                self._mcap, frame_encoding=self._encoding, event_schema=event_schema
            )
            for name in (METADATA, METADATA_COPY):
                self._mcap.write_metadata(name, to_strings(info))
        except RecordingError:
            with suppress(RecordingError):
                self._mcap.close()
            raise

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._mcap.size

    def write(
        self,
        frame: PdmFrame,
        truth: dict[str, Any] | None = None,
        *,
        temperature_c: float | None = None,
        humidity_percent: float | None = None,
    ) -> None:
        """Add one ping and flush it.

        Parameters
        ----------
        frame
            Of ``info.num_words`` words.
        truth
            What stood where: anything that JSON can say.
        temperature_c
            Air temperature at this ping, degrees Celsius; ``info.temperature_c`` if not given.
        humidity_percent
            Relative humidity at this ping; ``info.humidity_percent`` if not given.

        Raises
        ------
        DiskFull
            If there is no room for it; the file stays as it was before.
        RecordingError
            If the frame or its truth does not fit, or the disk does not take it.
        """
        self._check(frame)
        about = {
            "ping_index": int(frame.ping_index),
            "active": bool(frame.active),
            "time_uncertainty_ns": int(frame.time_uncertainty_ns),
            "clock_step_ns": int(frame.clock_step_ns),
            "temperature_c": self.info.temperature_c if temperature_c is None else temperature_c,
            "humidity_percent": self.info.humidity_percent
            if humidity_percent is None
            else humidity_percent,
        }
        time_ns = int(frame.ping_time_ns)
        messages: dict[str, bytes | None] = {"ping": self._json(about)}
        if truth is not None:
            messages["truth"] = self._json(truth)
            messages["truth/points"] = landmark_points(truth.get("landmarks"), time_ns)
        # Last: whoever has it has the whole ping.
        messages["pdm"] = encode_recorded(frame.ping_index, frame.words, self._encoding)
        with self._lock:
            if not self.pings_written:
                messages = {**layout_messages(self.info, time_ns), **messages}
            self._write(messages, time_ns)
            self.pings_written += 1

    def write_event(self, event: bytes, time_ns: int) -> None:
        """Add what was published of a ping, and its landmarks as points for viewers.

        Parameters
        ----------
        event
            A JSON object, UTF-8, as ``EVENTS.md`` has it; kept byte for byte.
        time_ns
            The ping's.

        Raises
        ------
        RecordingError
            If it is no JSON object, or the disk does not take it.
        """
        try:
            landmarks = json.loads(event)["landmarks"]
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise RecordingError(
                f"{self.path}: not an event, expected JSON with landmarks: {error}"
            ) from error
        self._write({"events": event, "detections": landmark_points(landmarks, time_ns)}, time_ns)

    def write_picture(self, image: bytes, time_ns: int, kind: str = "png") -> None:
        """Add a picture of a ping for viewers.

        Raises
        ------
        RecordingError
            If the disk does not take it.
        """
        self._write({"picture": foxglove.image(time_ns, FRAME_ID, image, kind)}, time_ns)

    def write_log(self, level: str, message: str, time_ns: int, name: str = "ertis") -> None:
        """Add a line of log; the level is one of ``foxglove.LOG_LEVELS``.

        Raises
        ------
        RecordingError
            If the disk does not take it.
        """
        self._write({"log": foxglove.log_line(time_ns, level, name, message)}, time_ns)

    def close(self) -> None:
        """Finish the file. May be called twice.

        Raises
        ------
        RecordingError
            If the disk does not take the end.
        """
        if self._syncing is not None:
            self._syncing.join()
        with self._lock:
            self._mcap.close(sync=self._sync_period_s is not None)

    def _check(self, frame: PdmFrame) -> None:
        if frame.words.shape != (self.info.num_words,):
            raise RecordingError(
                f"{self.path}: frame of shape {frame.words.shape}, expected "
                f"({self.info.num_words},) as the recording began"
            )
        if frame.pdm_rate_hz != self.info.pdm_rate_hz:
            raise RecordingError(
                f"{self.path}: frame at {frame.pdm_rate_hz} Hz, expected {self.info.pdm_rate_hz} "
                "as the recording began"
            )

    def _write(self, messages: Mapping[str, bytes | None], time_ns: int) -> None:
        given = {topic: data for topic, data in messages.items() if data is not None}
        with self._lock:
            self._mcap.write_chunk(
                [
                    Outgoing(self._channels[topic], time_ns, self._sequences[topic], data)
                    for topic, data in given.items()
                ]
            )
            self._sequences.update(given.keys())
            self._sync_if_due()

    def _sync_if_due(self) -> None:
        if self._sync_error is not None:
            raise self._sync_error
        period_s, now_s = self._sync_period_s, time.monotonic()
        if period_s is None or now_s - self._synced_s < period_s:
            return
        if period_s == 0:
            self._mcap.sync()
        elif self._syncing is None or not self._syncing.is_alive():
            # A slow disk must not keep the sonar waiting.
            self._synced_s = now_s
            self._syncing = threading.Thread(target=self._sync, name="sync", daemon=True)
            self._syncing.start()

    def _sync(self) -> None:
        try:
            self._mcap.sync()
        except RecordingError as error:
            self._sync_error = error

    def _json(self, value: dict[str, Any]) -> bytes:
        try:
            return json.dumps(value, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise RecordingError(f"{self.path}: this is not JSON: {error}") from error
