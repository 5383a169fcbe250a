"""Commands and their replies over a link, each with a deadline; and how to get back into step."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import dataclass

from ertis_driver.errors import DeviceBabbles, DeviceError, DeviceTimeout
from ertis_driver.links import Link
from ertis_driver.protocol import REPLY_BYTES, decode_reply, encode_command, encode_reply

log = logging.getLogger(__name__)

QUIET_S = 0.03  # what is on its way has no gaps this long: the link is clean then
READ_BYTES = 65_536
EXCHANGES_KEPT = 20


@dataclass(frozen=True, slots=True)
class Exchange:
    """One command and what came back, for error reports.

    monotonic_s : float
        ``time.monotonic()`` when it was sent.
    """

    monotonic_s: float
    sent: str
    received: str


class Exchanges:
    """Asks, and waits for the answer.

    Parameters
    ----------
    link
        An open byte pipe.
    timeout_s
        Patience for the whole of one answer, s.

    Attributes
    ----------
    kept : deque of Exchange
        The last 20, oldest first.
    bytes_lost : int
        Bytes that answered nothing.
    """

    def __init__(self, link: Link, timeout_s: float) -> None:
        self.link = link
        self.timeout_s = timeout_s
        self.bytes_lost = 0
        self.kept: deque[Exchange] = deque(maxlen=EXCHANGES_KEPT)
        self._buffer = memoryview(bytearray(READ_BYTES))

    def command(self, command: bytes, timeout_s: float | None = None) -> int:
        """Send one command and return the word that answers it.

        Raises
        ------
        DeviceTimeout, DeviceLost
        """
        return decode_reply(self.exchange(command, REPLY_BYTES, timeout_s))

    def exchange(
        self, command: bytes, num_reply_bytes: int, timeout_s: float | None = None
    ) -> bytes:
        """Send commands and return exactly so many bytes of answers.

        Raises
        ------
        DeviceTimeout, DeviceLost
        """
        patience_s = self.timeout_s if timeout_s is None else timeout_s
        sent_s = time.monotonic()
        deadline = sent_s + patience_s
        reply = bytearray(num_reply_bytes)
        count = 0
        try:
            self.link.write(command, deadline)
            while count < num_reply_bytes:
                got = self.link.read_into(memoryview(reply)[count:], deadline)
                if got == 0:
                    raise DeviceTimeout(
                        f"{self.link.name} answered {_shown(command)} with {count} of "
                        f"{num_reply_bytes} bytes in {patience_s:g} s: configure it again"
                    )
                count += got
        finally:
            self.note(sent_s, command, bytes(reply[:count]).hex(" ", 4))
        return bytes(reply)

    def write(self, command: bytes, timeout_s: float) -> None:
        """Send a farewell: nobody waits for its answer, nor minds if it is not taken."""
        sent_s = time.monotonic()
        try:
            self.link.write(command, sent_s + timeout_s)
        except DeviceError as error:
            log.debug("%s: %s", self.link.name, error)
        self.note(sent_s, command, "")

    def note(self, sent_s: float, command: bytes, received: str) -> None:
        """Keep an exchange that was made elsewhere."""
        self.kept.append(Exchange(sent_s, _shown(command), received))

    def settle(self, patience_s: float) -> int:
        """Throw away what still comes from before, until the link is quiet; return its bytes.

        Raises
        ------
        DeviceBabbles
            If it does not become quiet.
        DeviceLost
        """
        end = time.monotonic() + patience_s
        count = 0
        while got := self.link.read_into(self._buffer, time.monotonic() + QUIET_S):
            count += got
            self.bytes_lost += got
            if time.monotonic() > end:
                raise DeviceBabbles(
                    f"{self.link.name} sent {count} bytes in {patience_s:g} s unasked, and goes "
                    "on: stop its external trigger or replug it, or name another port"
                )
        if count:
            log.info("%s: %d stale bytes thrown away", self.link.name, count)
        return count

    def fence(self, version_word: int, patience_s: float) -> None:
        """Get back into step after a failure.

        The device answers in order. Once it has said its known version word, and then nothing,
        no frame or reply that was asked for before can still come.

        Raises
        ------
        DeviceTimeout
            If it does not say it.
        DeviceBabbles, DeviceLost
        """
        end = time.monotonic() + patience_s
        self.settle(patience_s)
        expected = encode_reply(version_word)
        command = encode_command("Y")
        while True:
            sent_s = time.monotonic()
            self.link.write(command, sent_s + self.timeout_s)
            last = self._last_word(expected, min(end, sent_s + self.timeout_s), end)
            self.note(sent_s, command, last.hex())
            if last == expected:
                self.bytes_lost -= REPLY_BYTES
                return
            if time.monotonic() >= end:
                raise DeviceTimeout(
                    f"{self.link.name} is out of step and gave no version for {patience_s:g} s: "
                    "configure it again, replug it if that persists"
                )

    def _last_word(self, expected: bytes, deadline: float, end: float) -> bytes:
        """The last four bytes before silence: 30 ms of it once they are the expected ones."""
        last = b""
        while True:
            wait_until = time.monotonic() + QUIET_S if last == expected else deadline
            got = self.link.read_into(self._buffer, wait_until)
            if got == 0:
                return last
            self.bytes_lost += got
            last = (last + bytes(self._buffer[max(0, got - REPLY_BYTES) : got]))[-REPLY_BYTES:]
            if time.monotonic() > end:
                raise DeviceBabbles(
                    f"{self.link.name} does not stop sending: stop its external trigger or replug "
                    "it, or name another port"
                )


def _shown(command: bytes) -> str:
    first, _, rest = command.decode("ascii").partition("\n")
    more = rest.count("\n")
    return f"{first} and {more} more" if more else first
