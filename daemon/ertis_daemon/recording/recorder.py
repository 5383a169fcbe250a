"""Records on demand and on events, in a thread of its own: a slow disk delays no ping."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ertis_daemon.config import RecordConfig
from ertis_daemon.events import dump_json, json_schema
from ertis_daemon.recording.folder import MEGABYTE, NoRoom, RecordingFolder
from ertis_daemon.recording.ring import FrameRing
from ertis_daemon.status import Status
from ertis_driver.closing import Closing
from ertis_driver.errors import RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter

log = logging.getLogger(__name__)

EVENTS_KEPT = 2048  # a minute's at 30 a second, 1.5 MB
SPARE_FRAMES = 16  # that may wait for the disk beyond those of the ring
MAX_SAVED = 10  # pings that could not be processed: the first ones tell
MAX_WAITING = MAX_SAVED + 4  # recordings for the disk, the one being written among them
LONGEST_S = 600.0  # one recording, however often it is triggered again
POLL_S = 0.1
JOIN_S = 1.0


@dataclass(slots=True)
class _Recording:
    """One that is under way; ``ends_s`` is monotonic."""

    path: Path
    info: RecordingInfo
    began_s: float
    ends_s: float
    frames: deque[PdmFrame]
    events: deque[tuple[bytes, int]]
    room: int
    missed: int = 0


class Recorder(Closing):
    """Keeps the last pings of a sonar, and writes them and those that follow when triggered.

    Parameters
    ----------
    config
        How much, and where to.
    name
        The sonar's.
    status
        ``recordings`` and ``recordings_failed`` are counted here.
    keeps_ring
        Whether pings from before a trigger are kept at all; without a way to trigger it, they
        would only cost memory.
    """

    def __init__(
        self, config: RecordConfig, name: str, status: Status, *, keeps_ring: bool
    ) -> None:
        self._config = config
        self._status = status
        self._folder = RecordingFolder(
            config.folder, name, config.folder_mb * MEGABYTE, config.keep_free_mb * MEGABYTE
        )
        self._keeps_ring = keeps_ring
        keep_s = config.before_s if keeps_ring else 0.0
        self._ring = FrameRing(keep_s, config.memory_mb * MEGABYTE)
        self._events: deque[tuple[bytes, int]] = deque(maxlen=EVENTS_KEPT)
        self._info: RecordingInfo | None = None
        self._changed = threading.Condition()
        self._now: _Recording | None = None
        self._waiting: deque[_Recording] = deque()
        self._saved = 0
        self._closed = False
        self._thread: threading.Thread | None = None

    def begin(self, info: RecordingInfo) -> None:
        """The sonar was opened: frames are of this kind from now on."""
        with self._changed:
            self._info = info
            self._ring.clear()
            self._events.clear()
            self._finish()

    def heard(self, frame: PdmFrame) -> None:
        """Keep a frame, and record it if a recording is under way. Returns at once."""
        with self._changed:
            self._ring.append(frame)
            now = self._now
            if now is None:
                return
            if time.monotonic() > now.ends_s:
                self._finish()
            elif len(now.frames) >= now.room:
                now.missed += 1
            else:
                now.frames.append(frame)
                self._changed.notify_all()

    @property
    def wants_events(self) -> bool:
        """Whether an event published now may get into a recording."""
        return self._keeps_ring or self._now is not None

    def published(self, event: bytes, time_ns: int) -> None:
        """Keep an event with its ping, of that time. Returns at once."""
        with self._changed:
            self._events.append((event, time_ns))
            if self._now is not None and len(self._now.events) < EVENTS_KEPT:
                self._now.events.append((event, time_ns))

    def trigger(
        self, reason: str, before_s: float | None = None, after_s: float | None = None
    ) -> Path:
        """Record the pings around now; a recording under way goes on for as long instead.

        Parameters
        ----------
        reason
            A word, for the file's name.
        before_s, after_s
            Instead of the configured ones; no more than was kept, s.

        Returns
        -------
        Path
            The file. It is finished ``after_s`` from now, unless the disk does not take it: that is
            found out, counted and logged later, by the thread that writes.

        Raises
        ------
        NoRoom
            If no folder is known, nothing was opened yet, or the disk is behind already.
        """
        config = self._config
        after_s = config.after_s if after_s is None else after_s
        with self._changed:
            ends_s = time.monotonic() + after_s
            if self._now is not None:
                self._now.ends_s = min(max(self._now.ends_s, ends_s), self._now.began_s + LONGEST_S)
                return self._now.path
            if self._info is None:
                raise NoRoom("the sonar was not open yet: nothing can be recorded of it")
            kept = self._ring.newest(config.before_s if before_s is None else before_s)
            since_ns = kept[0].ping_time_ns if kept else 0
            events = [one for one in self._events if kept and one[1] >= since_ns]
            self._now = self._start(reason, kept, ends_s, events)
            return self._now.path

    def save(self, frame: PdmFrame, reason: str) -> Path | None:
        """Record one ping by itself; only the first 10 of them."""
        with self._changed:
            if self._saved >= MAX_SAVED or self._info is None:
                return None
            try:
                path = self._start(reason, [frame], time.monotonic()).path
            except NoRoom as error:
                self.failed(error)
                return None
            self._saved += 1
            return path

    def failed(self, error: Exception) -> None:
        """Count and log a recording that did not come to be."""
        with self._changed:
            self._status.recordings_failed += 1
        log.error("nothing recorded: %s", error)

    def close(self) -> None:
        """Finish what is under way, in bounded time. May be called twice."""
        with self._changed:
            self._closed = True
            self._finish()
            thread = self._thread
        if thread is not None:
            thread.join(JOIN_S)
            if thread.is_alive():
                log.warning("a recording did not end within %g s: its last pings are lost", JOIN_S)

    def _start(
        self,
        reason: str,
        frames: list[PdmFrame],
        ends_s: float,
        events: Sequence[tuple[bytes, int]] = (),
    ) -> _Recording:
        assert self._info is not None
        if self._closed or self._is_behind(len(frames)):
            raise NoRoom("more recordings than the disk takes: wait for those under way")
        path = self._folder.new_path(re.sub(r"[^\w-]", "-", reason) or "on-demand")
        room = len(frames) + SPARE_FRAMES
        began_s = time.monotonic()
        recording = _Recording(
            path, self._info, began_s, ends_s, deque(frames), deque(events), room
        )
        self._waiting.append(recording)
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()
        self._changed.notify_all()
        return recording

    def _is_behind(self, num_frames: int) -> bool:
        """Whether so many more would wait for the disk that memory is not bounded any more."""
        assert self._info is not None
        held = num_frames + sum(len(one.frames) for one in self._waiting)
        size = 4 * self._info.num_words
        most = self._config.memory_mb * MEGABYTE + (MAX_SAVED + SPARE_FRAMES) * size
        return len(self._waiting) >= MAX_WAITING or held * size > most

    def _finish(self) -> None:
        """End the recording under way; the lock is held."""
        self._now = None
        self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._waiting:
                    if self._closed:
                        return
                    self._changed.wait(POLL_S)
                recording = self._waiting[0]
            try:
                self._write(recording)
                self._status.recordings += 1
            except (RecordingError, NoRoom) as error:
                self.failed(error)
            except Exception as error:
                log.exception("%s", recording.path)
                self.failed(error)
            with self._changed:
                self._waiting.popleft()
                if self._now is recording:
                    self._finish()

    def _write(self, recording: _Recording) -> None:
        size = 4 * recording.info.num_words
        # The first pings at once: no older recording goes for one that does not come to be.
        self._folder.make_room(recording.path, size * max(len(recording.frames) + 1, SPARE_FRAMES))
        schema = dump_json(json_schema())
        writer = RecordingWriter(recording.path, recording.info, event_schema=schema)
        try:
            with writer:
                while (frame := self._next(recording)) is not None:
                    if writer.pings_written and writer.pings_written % SPARE_FRAMES == 0:
                        self._folder.make_room(recording.path, SPARE_FRAMES * size)
                    writer.write(frame)
                while recording.events:
                    writer.write_event(*recording.events.popleft())
        finally:
            if not writer.pings_written:  # a full disk: what came before it is worth keeping
                with suppress(OSError):
                    recording.path.unlink()
        if not writer.pings_written:
            raise NoRoom(f"no ping came for {recording.path}")
        log.info("recorded %d pings: %s", writer.pings_written, recording.path)
        if recording.missed:
            log.warning(
                "%s misses %d pings: the disk is too slow", recording.path, recording.missed
            )

    def _next(self, recording: _Recording) -> PdmFrame | None:
        """The next frame to write; None at the end."""
        with self._changed:
            while not recording.frames:
                is_over = time.monotonic() > recording.ends_s or self._now is not recording
                if is_over or self._closed:
                    if self._now is recording:
                        self._finish()
                    return None
                self._changed.wait(POLL_S)
            return recording.frames.popleft()
