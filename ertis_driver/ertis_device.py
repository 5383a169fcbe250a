"""The hardware (or its emulator): the wire protocol over a link."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from ertis_driver import protocol
from ertis_driver.clock import HostClock
from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.discover import find_port
from ertis_driver.errors import (
    DeviceTimeout,
    ErtisError,
    FrameCorrupt,
    NotConfigured,
)
from ertis_driver.exchanges import Exchange, Exchanges
from ertis_driver.frame import PdmFrame
from ertis_driver.frame_reader import Arrival, FrameReader
from ertis_driver.links import Link, SerialLink
from ertis_driver.ping_counter import PingCounter
from ertis_driver.registers import Registers
from ertis_driver.trigger_time import Interval, commanded, heard_of
from ertis_driver.upload import Progress

log = logging.getLogger(__name__)


class ErtisDevice(Closing):
    """An eRTIS on a link; implements ``Sonar``. Owns the link, and asks who answers at once.

    A device whose ping counter starts anew has restarted and lost its chirp: the frame that shows
    it is dropped (``FrameCorrupt``), and the settings are sent again before the next ping.

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
    progress
        Called with samples sent and samples in all while a chirp is uploaded.
    clock
        The host's.

    Raises
    ------
    DeviceTimeout
        If nothing answers.
    WrongDevice
        If what answers is no eRTIS.
    DeviceBabbles
        If it sends without end.
    """

    def __init__(
        self,
        link: Link,
        address: str,
        *,
        timeout_s: float = 1.0,
        frame_timeout_s: float = 5.0,
        trigger_form: protocol.TriggerForm = "linux",
        progress: Progress | None = None,
        clock: HostClock | None = None,
    ) -> None:
        self._link = link
        self._frame_timeout_s = frame_timeout_s
        self._trigger_form = trigger_form
        self._clock = clock or HostClock()
        self._turn = threading.RLock()  # one ping or configuration at a time
        self._exchanges = Exchanges(link, timeout_s)
        self._registers = Registers(self._exchanges, progress)
        self._counter = PingCounter(1.0)
        self._settings: Settings | None = None
        self._reader: FrameReader | None = None
        self._lost_before = (0, 0)  # bytes and frames, by readers of other frame sizes
        self._unsettled = False
        self._restarted = False
        self._owed = 0  # pings since the last frame, which the device may still answer
        try:
            version = self._registers.identify(frame_timeout_s)
        except BaseException:
            link.close()
            raise
        self._info = DeviceInfo(
            address, protocol.parse_source(version), protocol.parse_firmware(version)
        )

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

    @property
    def exchanges(self) -> deque[Exchange]:
        """The last 20 commands and answers, oldest first."""
        return self._exchanges.kept

    @property
    def pings_lost(self) -> int:
        """Pings missing in the device's counter."""
        return self._counter.pings_lost

    @property
    def restarts(self) -> int:
        """How often the device's counter began anew unasked."""
        return self._counter.restarts

    @property
    def bytes_lost(self) -> int:
        """Bytes that belonged to no frame."""
        in_frames = self._reader.bytes_lost if self._reader else 0
        return self._exchanges.bytes_lost + self._lost_before[0] + in_frames

    @property
    def frames_corrupt(self) -> int:
        """Frames cut short or damaged."""
        return self._lost_before[1] + (self._reader.frames_corrupt if self._reader else 0)

    def configure(self, settings: Settings) -> None:
        """Send settings and chirp.

        Raises
        ------
        DeviceUnsupported
            If the firmware has no amplifier or external trigger, and one was asked for.
        DeviceTimeout, DeviceLost, DeviceBabbles, WrongDevice
            If it does not answer as an eRTIS.
        UploadFailed
            If it holds another chirp than was sent.
        OutOfStep
            If bytes of its answers were lost or doubled.
        """
        with self._turn:
            self._settings = None
            if self._reader is not None:
                in_frames, corrupt = self._reader.bytes_lost, self._reader.frames_corrupt
                self._lost_before = self._lost_before[0] + in_frames, self._lost_before[1] + corrupt
                self._reader = None
            if self._restarted:
                self._registers.forget()
            elif self._unsettled:
                self._registers.forget_chirp()  # who knows why a ping failed
            version = self._registers.identify(self._frame_timeout_s)
            self._registers.set(settings, version)
            if self._restarted or settings.first_ping_index is not None:
                self._counter.forget()
            self._counter.listening_s = settings.listening_s
            self._reader = FrameReader(
                self._link,
                settings.num_words,
                self._counter.plausible,
                listening_s=settings.listening_s,
                gap_s=self._exchanges.timeout_s,
                slack_s=self._frame_timeout_s,
            )
            self._restarted = self._unsettled = False
            self._settings = settings

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Ping and wait for the frame.

        Raises
        ------
        NotConfigured
            Before ``configure``, or if an external trigger is set.
        DeviceTimeout
            If no byte of the frame came in time.
        FrameCorrupt
            If only part of it came, it was damaged, or the device had restarted.
        DeviceLost
            If the device went away.
        """
        with self._turn:
            settings, reader = self._ready()
            if settings.external_trigger is not None:
                raise NotConfigured(
                    f"{self._link.name} pings at edges on pin {settings.external_trigger.pin}: use "
                    "wait_frame, or configure it without external_trigger"
                )
            if not reader.start_clean() or self._unsettled:
                self._exchanges.fence(self._registers.version_word, self._patience_s(settings))
                reader.start_clean()
            self._unsettled = True  # until a whole frame proves the opposite
            command = protocol.encode_trigger(active=active, form=self._trigger_form)
            before_s = time.monotonic()
            self._link.write(command, before_s + self._exchanges.timeout_s)
            triggered_s = commanded(before_s, time.monotonic())
            at = self._unix_ns(triggered_s)  # before a step of the clock can come between
            try:
                arrival = self._answer(before_s + self._patience_s(settings))
            except ErtisError as error:
                self._exchanges.note(before_s, command, f"{type(error).__name__}: {error}")
                raise
            self._exchanges.note(before_s, command, f"frame {arrival.raw.index}")
            self._unsettled = False
            return self._frame(arrival, settings, at, active=active)

    def wait_frame(self, timeout_s: float) -> PdmFrame:
        """Return the next frame that the external trigger makes the device send.

        The time of its ping is estimated from its arrival; ``time_uncertainty_ns`` says how well.

        Parameters
        ----------
        timeout_s
            Patience for a frame to begin, s.

        Raises
        ------
        NotConfigured
            Before ``configure``, or if no external trigger is set.
        DeviceTimeout
            If no frame began in time.
        FrameCorrupt
            If only part of it came, it was damaged, or the device had restarted.
        DeviceLost
            If the device went away.
        """
        with self._turn:
            settings, _ = self._ready()
            trigger = settings.external_trigger
            if trigger is None:
                raise NotConfigured(
                    f"{self._link.name} has no external trigger set: configure it with one, or ping"
                )
            deadline = time.monotonic() + timeout_s
            try:
                arrival = self._next_ping(lambda: deadline)
            except DeviceTimeout as error:
                raise DeviceTimeout(
                    f"no edge on pin {trigger.pin} of {self._link.name} in {timeout_s:g} s, or its "
                    "frame was lost: wait again, or look at the trigger's wiring"
                ) from error
            triggered_s = heard_of(arrival, settings.listening_s)
            at = self._unix_ns(triggered_s)
            return self._frame(arrival, settings, at, active=trigger.active)

    def close(self) -> None:
        """Give the link back. May be called twice, and from any thread.

        What this session switched on is switched off, unless another thread is in the middle of a
        ping, which ends with ``DeviceLost``.
        """
        if self._turn.acquire(blocking=False):
            try:
                if self._settings is not None:
                    self._settings = None
                    self._registers.leave()
            finally:
                self._turn.release()
        self._link.close()

    def _ready(self) -> tuple[Settings, FrameReader]:
        if self._restarted and self._settings is not None:
            log.warning("%s: restarted, its settings are sent again", self._link.name)
            self.configure(self._settings)
        if self._settings is None or self._reader is None:
            raise NotConfigured(f"{self._link.name} holds no settings: configure it first")
        return self._settings, self._reader

    def _patience_s(self, settings: Settings) -> float:
        return self._frame_timeout_s + settings.listening_s

    def _answer(self, deadline_s: float) -> Arrival:
        """The frame of this ping, not one that an earlier ping's patience did not last for.

        What was asked is answered in its order: behind a late frame comes one more.
        """
        owed, self._owed = self._owed, self._owed + 1
        while True:
            last = self._counter.last_index
            try:
                arrival = self._next_ping(lambda: deadline_s)
            except FrameCorrupt:
                if last is None or self._restarted:
                    self._owed = 0  # damaged, but an answer
                raise
            # With nothing to count from, the first one is late if there may be a late one at all.
            ahead = 1 if last is None else (arrival.raw.index - last) % protocol.INDEX_MODULUS
            if not 0 < ahead <= owed:
                self._owed = 0
                return arrival
            log.warning("ping %d: its frame came late, dropped", arrival.raw.index)
            self._counter.drop()
            # If no more comes, the device missed a ping: the next frame is the next ping's.
            owed, self._owed = owed - ahead, 0

    def _next_ping(self, deadline: Callable[[], float]) -> Arrival:
        assert self._reader is not None
        while True:
            last = self._counter.last_index
            arrival = self._reader.read(deadline())
            step = self._counter.take(arrival.raw.index)
            if step == "next":
                return arrival
            if step == "restart":
                self._restarted = True
                raise FrameCorrupt(
                    f"ping {arrival.raw.index} of {self._link.name} follows ping {last}: it "
                    "restarted and lost its settings, or the frame is damaged; ping again, they "
                    "are sent again before"
                )
            log.warning("ping %d came again: dropped", arrival.raw.index)

    def _unix_ns(self, interval_s: Interval) -> tuple[int, int]:
        """UNIX time of the middle of an interval, and half its width, ns."""
        time_ns, error_ns = self._clock.unix_ns(sum(interval_s) / 2)
        return time_ns, round((interval_s[1] - interval_s[0]) / 2 * 1e9) + error_ns

    def _frame(
        self,
        arrival: Arrival,
        settings: Settings,
        at: tuple[int, int],
        *,
        active: bool,
    ) -> PdmFrame:
        step_ns = self._clock.take_step_ns()
        if step_ns:
            log.warning("ping %d: the clock was set by %d ns", arrival.raw.index, step_ns)
        return PdmFrame(
            words=arrival.raw.words,
            ping_index=arrival.raw.index,
            ping_time_ns=at[0],
            time_uncertainty_ns=at[1],
            active=active,
            pdm_rate_hz=settings.pdm_rate_hz,
            clock_step_ns=step_ns,
        )


def open_serial(
    port: str,
    *,
    timeout_s: float = 1.0,
    frame_timeout_s: float = 5.0,
    trigger_form: protocol.TriggerForm = "linux",
    progress: Progress | None = None,
) -> ErtisDevice:
    """Open the eRTIS on a serial port: ``/dev/ttyACM0``, or ``sn=ABC`` by its serial number.

    Raises
    ------
    DeviceNotFound, DevicePermission, DeviceBusy, WrongDevice, DeviceTimeout, DeviceBabbles
    """
    return ErtisDevice(
        SerialLink(find_port(port)),
        f"serial:{port}",
        timeout_s=timeout_s,
        frame_timeout_s=frame_timeout_s,
        trigger_form=trigger_form,
        progress=progress,
    )
