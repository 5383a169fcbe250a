"""What cases do with a device, whatever link it is on."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Sequence

import numpy as np
from typing_extensions import Self

from ertis_driver.chirp import Chirp
from ertis_driver.device import Settings
from ertis_driver.errors import DeviceError, DeviceNotFound, PingLost
from ertis_driver.open import open_device
from ertis_driver.reconnect import ReconnectingSonar
from qemu.inside.board import Board
from qemu.inside.firmware import Vanish, sound
from qemu.inside.looking import open_files, wait_for

SHORT = Settings(num_words=32_768)
QUICK = Settings(Chirp(duration_s=0.2e-3), 32_768)  # where the chirp's upload is beside the point
PATIENT = {"timeout_s": 5.0}  # an emulated machine, maybe on a busy one, may take a second off
FRAME_BYTES = 4 * 32_768 + 12
WATCH_S = 0.03  # more often, and looking would slow down what it looks at


def as_sent(frame) -> bool:
    """Whether a frame is what the board heard at that ping, bit for bit."""
    sent = sound(frame.ping_index, len(frame.words), active=frame.active)
    return np.array_equal(frame.words, sent)


def configured(device) -> dict:
    """Configure it with the defaults."""
    started_s = time.monotonic()
    device.configure(Settings())
    return {"configure_s": round(time.monotonic() - started_s, 2)}


def listening(device, count: int) -> dict:
    """``count`` active pings: how many came as sent, how fast, at what cost."""
    started_s, cpu_s = time.monotonic(), time.process_time()
    frames = [device.ping() for _ in range(count)]
    took_s, cpu_s = time.monotonic() - started_s, time.process_time() - cpu_s
    num_bytes = sum(4 * len(frame.words) for frame in frames)
    return {
        "as_sent": sum(map(as_sent, frames)),
        "indices": [frame.ping_index for frame in frames],
        "frames_per_s": round(count / took_s, 2),
        "mb_per_s": round(num_bytes / took_s / 1e6, 2),
        "cpu_s_per_frame": round(cpu_s / count, 4),
    }


def losing(
    board: Board, address: str, nodes: str, at: Sequence[int] = (0, 5, 60_000, FRAME_BYTES - 1)
) -> dict:
    """Unplug it at the beginning, in the middle and before the end of a frame."""
    result: dict = {"as_sent_before": [], "held_before": [], "ended": [], "held_after": []}
    for place in at:
        with wait_for(lambda: opened(address)) as device:
            device.configure(QUICK)
            result["as_sent_before"].append(as_sent(device.ping()))
            result["held_before"].append(len(open_files(nodes)))
            board.misbehave(Vanish(place, away_s=0.5))
            try:
                device.ping()
                result["ended"].append("a frame")
            except DeviceError as error:
                result["ended"].append(f"{type(error).__name__}: {error}")
            # Before close: nobody may keep the name of the port taken.
            result["held_after"] += open_files(nodes)
        board.wait_until_plugged()
    return result


def opened(address: str):
    """The device, or None if it is not there yet."""
    try:
        return open_device(address, **PATIENT)
    except DeviceNotFound:
        return None


def coming_back(board: Board, address: str, nodes: str) -> dict:
    """Unplug it in mid-frame under a ``ReconnectingSonar``; ping until it is heard again."""
    heard = _Warnings()
    with ReconnectingSonar(address, SHORT, **PATIENT) as sonar, heard:
        before = as_sent(sonar.ping())
        board.misbehave(Vanish(at=60_000, away_s=1.0))
        lost: list[str] = []
        with _Watch(nodes) as watch:
            while True:
                try:
                    frame = sonar.ping()
                    break
                except PingLost as error:
                    lost.append(str(error))
        heard_s = time.monotonic()
        plugged_s = board.plugged_at()
        return {
            "as_sent_before": before,
            "as_sent_after": as_sent(frame),
            "index_after": frame.ping_index,
            "lost": lost,
            "reopened_s": round(watch.opened_s(plugged_s) - plugged_s, 3),
            "heard_again_s": round(heard_s - plugged_s, 3),
            "node_after": open_files(nodes),
            "reconnects": sonar.reconnects,
            "warnings": heard.messages,
        }


class _Watch(threading.Thread):
    """Notes when this process has a file open under a path, without a hand in the driver."""

    def __init__(self, prefix: str) -> None:
        super().__init__(daemon=True)
        self._prefix = prefix
        self._over = threading.Event()
        self._openings_s: list[float] = []

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_) -> None:
        self._over.set()
        self.join()

    def run(self) -> None:
        before: list[str] = []
        while not self._over.wait(WATCH_S):
            now = open_files(self._prefix)
            if now and now != before:
                self._openings_s.append(time.monotonic())
            before = now

    def opened_s(self, after_s: float) -> float:
        """The last opening, which is the one that worked; ``time.monotonic()``, s."""
        return max(opened_s for opened_s in self._openings_s if opened_s > after_s)


class _Warnings(logging.Handler):
    """What ``ReconnectingSonar`` tells its user."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.messages.append(record.getMessage())

    def __enter__(self) -> Self:
        logging.getLogger("ertis_driver.reconnect").addHandler(self)
        return self

    def __exit__(self, *_) -> None:
        logging.getLogger("ertis_driver.reconnect").removeHandler(self)
