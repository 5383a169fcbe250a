"""What systemd wants to hear of a service: sd_notify(3), a datagram each."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time

log = logging.getLogger(__name__)


class Notifier:
    """Tells systemd how the service is; without systemd it tells nobody.

    The watchdog is fed by whoever calls ``beat``: the loops that process pings. No timer does, so
    a loop that hangs is ended and started again.
    """

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        self._lock = threading.Lock()
        self._status = ""
        watched = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = os.environ.get("WATCHDOG_USEC", "") if watched else ""
        # Twice as often as it must be, as sd_watchdog_enabled(3) advises, and a bit.
        self._period_s = int(usec) / 1e6 / 3 if usec.isdigit() else float("inf")
        self._fed_s = 0.0

    def ready(self) -> None:
        """Say that events may be expected from now on."""
        self._send("READY=1")

    def stopping(self) -> None:
        """Say that the end is wanted."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Say in one line how it goes; said once, until it changes."""
        if text != self._status:
            self._status = text
            self._send(f"STATUS={' '.join(text.split())}")

    def beat(self) -> None:
        """Feed the watchdog, if it is time to."""
        now_s = time.monotonic()
        with self._lock:
            if now_s - self._fed_s < self._period_s:
                return
            self._fed_s = now_s
        self._send("WATCHDOG=1")

    def _send(self, message: str) -> None:
        if not self._address:
            return
        name = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
                out.settimeout(0.1)  # a systemd that does not read must not hold up a ping
                out.sendto(message.encode(), name)
        except OSError as error:
            log.warning("systemd does not listen on %s: %s", self._address, error)
