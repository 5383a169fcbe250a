"""The hardware (or its emulator): the wire protocol over a link."""

from __future__ import annotations

import logging
import time
from collections import deque
from dataclasses import dataclass

from ertis_driver import protocol
from ertis_driver.chirp import Chirp
from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.errors import (
    DeviceError,
    DeviceTimeout,
    ErtisError,
    FrameCorrupt,
    NotConfigured,
    WrongDevice,
)
from ertis_driver.frame import PDM_RATE_HZ, PdmFrame
from ertis_driver.frame_parser import FrameParser
from ertis_driver.links import Link, SerialLink

log = logging.getLogger(__name__)

QUIET_S = 0.03  # a frame still on its way has no gaps this long: the link is clean then
UPLOAD_BATCH = 16  # commands of at most 16 B: half a high-speed USB packet in flight
MIN_BYTES_PER_S = 4e6  # far below USB high speed (33e6 at best); for the deadline only
READ_BYTES = 65_536
MAX_GAP = 1_000_000  # a day at 10 Hz; a larger jump is a counter that started anew
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


class ErtisDevice(Closing):
    """An eRTIS on a link; implements ``Sonar``. Owns the link, and asks who answers at once.

    Parameters
    ----------
    link
        An open byte pipe.
    address
        What the user called it.
    timeout_s
        Patience for a reply word, and for a frame that stops half-way, s.
    frame_timeout_s
        Patience for a frame, s, on top of the time it takes to listen and to send. Hardware needs
        none of it; an emulator with a simulated world computes for up to a second.
    trigger_form
        How ``A`` is sent; the incumbent's Linux and Windows clients disagree.

    Attributes
    ----------
    pings_lost : int
        Gaps in the device's ping counter.
    exchanges : deque of Exchange
        The last 20, oldest first.

    Raises
    ------
    DeviceTimeout
        If nothing answers.
    WrongDevice
        If what answers is no eRTIS.
    """

    def __init__(
        self,
        link: Link,
        address: str,
        *,
        timeout_s: float = 1.0,
        frame_timeout_s: float = 5.0,
        trigger_form: protocol.TriggerForm = "linux",
    ) -> None:
        self._link = link
        self._address = address
        self._timeout_s = timeout_s
        self._frame_timeout_s = frame_timeout_s
        self._trigger_form = trigger_form
        self._settings: Settings | None = None
        self._parser: FrameParser | None = None
        self._buffer = memoryview(bytearray(READ_BYTES))
        self._last_index: int | None = None
        self._unsettled = True
        self.pings_lost = 0
        self.exchanges: deque[Exchange] = deque(maxlen=EXCHANGES_KEPT)
        try:
            self._info = self._identify()
        except BaseException:
            link.close()
            raise

    @property
    def info(self) -> DeviceInfo:
        """Who answers."""
        return self._info

    @property
    def settings(self) -> Settings | None:
        """What it is configured to do; None before ``configure`` or after a failed one."""
        return self._settings

    @property
    def is_live(self) -> bool:
        """Whether real hardware made the frames."""
        return self._info.source == "live"

    def configure(self, settings: Settings) -> None:
        """Send settings and chirp.

        Raises
        ------
        DeviceTimeout, DeviceLost, WrongDevice
            If it does not answer as an eRTIS.
        DeviceError
            If it holds another chirp than was sent.
        """
        self._settings = None
        chirp = settings.chirp
        self._info = self._identify()
        try:
            self._command(protocol.encode_frame_size(settings.num_words))
            self._command(protocol.encode_command("F", 0))
            self._command(protocol.encode_command("D", chirp.dac_rate_hz))
            self._command(protocol.encode_command("E", chirp.num_dac_samples))
            self._command(protocol.encode_command("L"))
            self._upload_checked(chirp)
            self._command(protocol.encode_command("I", 1))
        except ErtisError:
            self._unsettled = True
            raise
        if self._parser is None or self._parser.num_words != settings.num_words:
            self._parser = FrameParser(settings.num_words)
        self._settings = settings

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Ping and wait for the frame.

        Raises
        ------
        NotConfigured
            Before ``configure``.
        DeviceTimeout
            If no byte of the frame came in time.
        FrameCorrupt
            If only part of it came, or it was damaged.
        DeviceLost
            If the device went away.
        """
        if self._settings is None or self._parser is None:
            raise NotConfigured(f"{self._link.name} holds no settings: configure it first")
        if self._unsettled:
            self._settle()
        self._unsettled = True  # until a whole frame proves the opposite
        self._parser.clear()
        command = protocol.encode_trigger(active=active, form=self._trigger_form)
        sent_s = time.monotonic()
        before_ns = time.time_ns()
        self._link.write(command, sent_s + self._timeout_s)
        after_ns = time.time_ns()
        try:
            frame = self._read_frame(self._parser)
        except ErtisError as error:
            self._note(sent_s, command, f"{type(error).__name__}: {error}")
            raise
        self._note(sent_s, command, f"frame {frame.index}, {len(frame.words)} words")
        self._unsettled = False
        self._count_lost(frame.index)
        return PdmFrame(
            words=frame.words,
            ping_index=frame.index,
            ping_time_ns=(before_ns + after_ns) // 2,
            time_uncertainty_ns=(max(0, after_ns - before_ns) + 1) // 2,
            active=active,
        )

    def close(self) -> None:
        """Give the link back. May be called twice."""
        self._settings = None
        self._link.close()

    def _identify(self) -> DeviceInfo:
        self._settle()
        try:
            word = self._command(protocol.encode_command("Y"))
            source = protocol.parse_source(word)
        except DeviceTimeout as error:
            raise DeviceTimeout(
                f"no answer in {self._timeout_s:g} s at {self._link.name}: not an eRTIS, or it "
                "hangs; check the port name, or replug it"
            ) from error
        except WrongDevice as error:
            raise WrongDevice(f"{self._link.name}: {error}; name another port") from error
        return DeviceInfo(self._address, source, protocol.parse_firmware(word))

    def _upload_checked(self, chirp: Chirp) -> None:
        codes = [int(code) for code in chirp.dac_codes()]
        expected = protocol.chirp_hash(chirp.dac_codes())
        # Never skipped, whatever the hash was before: it is blind to order.
        self._upload(codes)
        met = self._command(protocol.encode_command("L"))
        if met == expected:
            return
        # Nobody knows whether L covers the samples in use or the whole buffer. With zeros in the
        # former, it yields what the rest of the buffer adds.
        log.info("%s: chirp hash 0x%x, expected 0x%x: checking", self._link.name, met, expected)
        self._upload([0] * len(codes))
        rest = self._command(protocol.encode_command("L"))
        self._upload(codes)
        met = self._command(protocol.encode_command("L"))
        if met ^ rest != expected:
            raise DeviceError(
                f"{self._link.name} holds another chirp than was sent (hash 0x{met ^ rest:x}, "
                f"expected 0x{expected:x}): configure it again, replug it if that persists"
            )

    def _upload(self, codes: list[int]) -> None:
        for start in range(0, len(codes), UPLOAD_BATCH):
            batch = codes[start : start + UPLOAD_BATCH]
            self._exchange(
                b"".join(
                    protocol.encode_command("C", start + offset, code)
                    for offset, code in enumerate(batch)
                ),
                protocol.REPLY_BYTES * len(batch),
            )

    def _command(self, command: bytes) -> int:
        return protocol.decode_reply(self._exchange(command, protocol.REPLY_BYTES))

    def _exchange(self, command: bytes, num_reply_bytes: int) -> bytes:
        sent_s = time.monotonic()
        deadline = sent_s + self._timeout_s
        reply = bytearray(num_reply_bytes)
        count = 0
        try:
            self._link.write(command, deadline)
            while count < num_reply_bytes:
                got = self._link.read_into(memoryview(reply)[count:], deadline)
                if got == 0:
                    raise DeviceTimeout(
                        f"{self._link.name} answered {_shown(command)} with {count} of "
                        f"{num_reply_bytes} bytes in {self._timeout_s:g} s: configure it again"
                    )
                count += got
        finally:
            self._note(sent_s, command, bytes(reply[:count]).hex(" ", 4))
        return bytes(reply)

    def _read_frame(self, parser: FrameParser) -> protocol.RawFrame:
        size = protocol.frame_bytes(parser.num_words)
        patience_s = self._frame_timeout_s + parser.num_words / PDM_RATE_HZ + size / MIN_BYTES_PER_S
        started_s = time.monotonic()
        final = started_s + patience_s
        deadline = final
        corrupt = parser.frames_corrupt
        met = 0
        while True:
            count = self._link.read_into(self._buffer, deadline)
            if count == 0:
                break
            met += count
            frames = parser.feed(self._buffer[:count])
            if frames:
                return frames[-1]
            # Once it talks, silence is failure: do not wait for the whole deadline.
            deadline = min(final, time.monotonic() + self._timeout_s)
        parser.clear()
        waited_s = time.monotonic() - started_s
        if met == 0:
            raise DeviceTimeout(
                f"no frame from {self._link.name} in {waited_s:.1f} s: ping again, or replug it"
            )
        damage = "header or footer wrong" if parser.frames_corrupt > corrupt else "then silence"
        raise FrameCorrupt(
            f"frame from {self._link.name}: {met} of {size} bytes in {waited_s:.1f} s, {damage}; "
            "ping again"
        )

    def _settle(self) -> None:
        """Throw away what still comes from before, until the link is quiet."""
        end = time.monotonic() + self._frame_timeout_s
        count = 0
        while time.monotonic() < end:
            got = self._link.read_into(self._buffer, time.monotonic() + QUIET_S)
            if got == 0:
                break
            count += got
        if count:
            log.info("%s: %d stale bytes thrown away", self._link.name, count)
        self._unsettled = False

    def _count_lost(self, index: int) -> None:
        if self._last_index is not None:
            gap = (index - self._last_index) % protocol.INDEX_MODULUS - 1
            if 0 < gap <= MAX_GAP:
                self.pings_lost += gap
                log.warning("ping %d: %d lost before it", index, gap)
            elif gap != 0:
                log.warning("ping %d follows ping %d: counter reset", index, self._last_index)
        self._last_index = index

    def _note(self, sent_s: float, command: bytes, received: str) -> None:
        self.exchanges.append(Exchange(sent_s, _shown(command), received))


def _shown(command: bytes) -> str:
    first, _, rest = command.decode("ascii").partition("\n")
    more = rest.count("\n")
    return f"{first} and {more} more" if more else first


def open_serial(
    port: str,
    *,
    timeout_s: float = 1.0,
    frame_timeout_s: float = 5.0,
    trigger_form: protocol.TriggerForm = "linux",
) -> ErtisDevice:
    """Open the eRTIS on a serial port, for example ``/dev/ttyACM0``.

    Raises
    ------
    DeviceNotFound, DevicePermission, DeviceBusy, WrongDevice, DeviceTimeout
    """
    return ErtisDevice(
        SerialLink(port),
        f"serial:{port}",
        timeout_s=timeout_s,
        frame_timeout_s=frame_timeout_s,
        trigger_form=trigger_form,
    )
