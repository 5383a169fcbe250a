"""The live table of ``ertis monitor``: a block a sonar, a line a landmark."""

from __future__ import annotations

import json
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

from ertis_daemon.cli.monitor import HINT, format_landmark, number
from ertis_driver.closing import Closing

REFRESH_S = 0.2
STALE_S = 2.0  # a track that nobody spoke of for so long is not shown any more
SILENT_S = 3.0  # status comes every second

_ENTER, _LEAVE = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"  # another screen, no cursor
_HOME, _TO_END_OF_LINE, _TO_END = "\x1b[H", "\x1b[K", "\x1b[J"


class Board:
    """What was last said by each sonar, and of each landmark; ``place`` is where it listens."""

    def __init__(self, place: str) -> None:
        self._place = place
        self._statuses: dict[str, tuple[float, Mapping[str, Any]]] = {}
        self._tracks: dict[tuple[str, int], tuple[float, Mapping[str, Any]]] = {}
        self._sources: dict[str, str] = {}

    def take_status(self, device: str, status: Mapping[str, Any], now_s: float) -> None:
        """Note a status message."""
        self._statuses[device] = now_s, status

    def take_event(self, event: Mapping[str, Any], now_s: float) -> None:
        """Note an event.

        Raises
        ------
        KeyError, TypeError
            If it is none.
        """
        device = str(event["device"])
        self._sources[device] = str(event["source"])
        for item in event["landmarks"]:
            format_landmark(item)  # raises here, not at each refresh
            self._tracks[device, item["track_id"]] = now_s, item

    def lines(self, now_s: float) -> list[str]:
        """The table as text."""
        self._tracks = {
            key: (at_s, item)
            for key, (at_s, item) in self._tracks.items()
            if now_s - at_s < STALE_S and item["state"] != "lost"
        }
        devices = sorted({*self._statuses, *(device for device, _ in self._tracks)})
        if not devices:
            return [f"no sonar heard of at {self._place} yet; {HINT}"]
        lines = []
        for device in devices:
            lines += [self._head(device, now_s), *self._landmarks(device), ""]
        return lines

    def _head(self, device: str, now_s: float) -> str:
        if device not in self._statuses:
            return f"{device}  {self._sources.get(device, '')}"
        at_s, status = self._statuses[device]
        if now_s - at_s > SILENT_S:
            return f"{device}  SILENT for {now_s - at_s:.0f} s"
        source = status.get("source") or self._sources.get(device, "")
        parts = [
            f"{device}  {status.get('state', '?')}  {source}",
            f"{number(status.get('ping_rate_hz'), 1, '.1f')} pings/s",
            f"{status.get('pings_lost', '?')} lost  {status.get('queue_drops', '?')} dropped",
            f"latency p99 {number(status.get('latency_p99_ms'), 1, '.1f')} ms",
        ]
        faulty = status.get("microphones_faulty") or {}
        if faulty:
            parts.append("microphones " + " ".join(f"{row} {faulty[row]}" for row in faulty))
        failing = status.get("outputs_failing") or {}
        parts += [f"{way} fail: {failing[way]}" for way in failing]
        if status.get("reason"):
            parts.append(str(status["reason"]))
        return "  |  ".join(parts)

    def _landmarks(self, device: str) -> list[str]:
        near_first = sorted(
            (item for (name, _), (_, item) in self._tracks.items() if name == device),
            key=lambda item: (item["range_m"] is None, item["range_m"]),
        )
        return [f"  {format_landmark(item)}" for item in near_first] or ["  no landmark"]


class LiveTable(Closing):
    """Draws a board on the terminal until closed; then the terminal is as it was.

    Parameters
    ----------
    next_status
        Returns the next status sample that waits, or None.
    place
        Where it listens, for people.
    """

    def __init__(self, next_status: Callable[[], Any], place: str) -> None:
        self._board = Board(place)
        self._next_status = next_status
        self._due_s = 0.0
        self._is_open = True
        sys.stdout.write(_ENTER)

    def show(self, payload: bytes, key: str) -> None:
        """Take an event; what is none of ours is passed over."""
        try:
            self._board.take_event(json.loads(payload), time.monotonic())
        except (ValueError, KeyError, TypeError, AttributeError):
            return

    def refresh(self) -> None:
        """Take the statuses that wait, and draw if it is time to."""
        now_s = time.monotonic()
        while (sample := self._next_status()) is not None:
            device = str(sample.key_expr).split("/")[1]
            try:
                self._board.take_status(device, dict(json.loads(sample.payload.to_bytes())), now_s)
            except (ValueError, TypeError):
                continue
        if now_s >= self._due_s:
            self._due_s = now_s + REFRESH_S
            self._draw(now_s)

    def close(self) -> None:
        """Give the terminal back. May be called twice."""
        if self._is_open:
            self._is_open = False
            sys.stdout.write(_LEAVE)
            sys.stdout.flush()

    def _draw(self, now_s: float) -> None:
        width, height = shutil.get_terminal_size()
        clock = time.strftime("%H:%M:%S")
        lines = [f"ertis monitor  {clock}  (Ctrl-C ends it)", "", *self._board.lines(now_s)]
        shown = [line[:width] + _TO_END_OF_LINE for line in lines[: height - 1]]
        sys.stdout.write(_HOME + "\r\n".join(shown) + _TO_END)
        sys.stdout.flush()
