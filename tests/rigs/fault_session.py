"""One emulated sonar and one client of it that does what the errors' names say."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from fault_ledger import NUM_WORDS, Ledger, Sent

from ertis_driver.chirp import Chirp
from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.emulator import Emulator
from ertis_driver.errors import (
    DeviceError,
    DeviceLost,
    DeviceNotFound,
)
from ertis_driver.ertis_device import ErtisDevice, open_serial
from ertis_driver.faults import Fault

CHIRP = Chirp("hyperbolic", 50_000.0, 25_000.0, 0.00015)  # 68 DAC samples: configured in 1 ms
ASKED = Settings(CHIRP, NUM_WORDS)
UNASKED = Settings(CHIRP, NUM_WORDS, external_trigger=ExternalTrigger(pin=1))
TIMEOUT_S = 0.4  # what a pty on a busy machine may take
FRAME_TIMEOUT_S = 0.6
MAX_ATTEMPTS = 40
REPLUG_S = 20.0  # what is unplugged for 50 ms is back by then, however busy the machine
PINGS_BEFORE_CONFIGURE = 3
CONFIGURES_BEFORE_REOPEN = 3


@dataclass(slots=True)
class Outcome:
    """What one fault did.

    errors : list of str
        Names of what was raised until the next good frame.
    frames_lost : int
        Frames made from the fault on that were not delivered.
    recovery_s : float
        From the fault to the next good frame.
    """

    errors: list[str] = field(default_factory=list)
    frames_lost: int = 0
    recovery_s: float = 0.0


class Session:
    """A device, its client, and the ledger between them.

    Parameters
    ----------
    settings
        ``ASKED``: the client pings; ``UNASKED``: edges come in pairs, one close behind the other.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._edges = self._last_edge = 0  # whose frames are awaited; the last one's serial
        self._folder = tempfile.TemporaryDirectory(prefix="ertis-faults-")
        link = Path(self._folder.name) / "sonar"
        self.ledger = Ledger()
        self._emulator = Emulator(self.ledger, faults=self.ledger, link=link)
        self._emulator.start()
        self._port = str(link)
        self._codes = CHIRP.dac_codes()
        self._device: ErtisDevice | None = None
        self._failed_pings = 0
        self._failed_configures = 0
        self._last: Sent | None = None
        self._pings_lost = self._restarts = 0
        self._until_good()
        self._replies = self._count_replies()

    def close(self) -> None:
        """End both."""
        if self._device is not None:
            self._device.close()
        self._emulator.close()
        self._folder.cleanup()

    def run(self, fault: Fault, unit: str, countdown: int) -> Outcome:
        """Let the fault happen and go on until a frame made after it is delivered.

        Raises
        ------
        AssertionError
            If a frame is wrong, a loss uncounted, or if it does not recover.
        """
        outcome = Outcome()
        self._until_good()
        first = len(self.ledger.sent)
        if unit == "reply":
            self.ledger.arm(fault, unit, countdown % self._replies)
        else:
            self.ledger.arm(fault, "frame")
        for _ in range(MAX_ATTEMPTS):
            # One opening may have a reply less than another: the farewell of the one before is
            # lost if the emulator did not read it in time.
            due = unit == "reply" and self.ledger.fired_s is None
            serial = self._attempt(outcome, self._reopen if due else self._next_step())
            if serial is None or self.ledger.fired_s is None:
                continue
            if outcome.recovery_s == 0.0:
                outcome.recovery_s = time.monotonic() - self.ledger.fired_s
            if serial > self.ledger.fired_serial or unit == "reply":
                break
        else:
            happened = "never happened" if self.ledger.fired_s is None else "happened"
            raise AssertionError(
                f"no good frame in {MAX_ATTEMPTS} attempts, the fault {happened}: {outcome.errors}"
            )
        outcome.frames_lost = sum(not sent.delivered for sent in self.ledger.sent[first:serial])
        return outcome

    def _until_good(self) -> None:
        for _ in range(MAX_ATTEMPTS):
            if self._device is not None and self._failed_pings == self._failed_configures == 0:
                return
            self._attempt(Outcome(), self._next_step())
        raise AssertionError(f"not ready in {MAX_ATTEMPTS} attempts")

    def _count_replies(self) -> int:
        """How many an opening gets when nothing goes wrong."""
        for _ in range(MAX_ATTEMPTS):
            before, outcome = self._emulator.injector.num_replies, Outcome()
            self._attempt(outcome, self._reopen)
            if not outcome.errors:
                return self._emulator.injector.num_replies - before
        raise AssertionError(f"no opening without an error in {MAX_ATTEMPTS} attempts")

    def _next_step(self):
        if self._device is None or self._failed_configures >= CONFIGURES_BEFORE_REOPEN:
            return self._reopen
        if self._device.settings is None or self._failed_pings >= PINGS_BEFORE_CONFIGURE:
            return self._configure
        return self._ping if self._settings is ASKED else self._hear

    def _attempt(self, outcome, step) -> int | None:
        try:
            return step()
        except DeviceNotFound:
            self._await_plug()
        except DeviceError as error:
            outcome.errors.append(type(error).__name__)
            if isinstance(error, DeviceLost) and self._device is not None:
                self._device.close()
                self._device = None
        return None

    def _await_plug(self) -> None:
        end_s = time.monotonic() + REPLUG_S
        while not Path(self._port).exists():
            assert time.monotonic() < end_s, f"not plugged in again in {REPLUG_S} s"
            time.sleep(0.01)

    def _reopen(self) -> None:
        if self._device is not None:
            self._device.close()
            self._device = None
        self._device = open_serial(self._port, timeout_s=TIMEOUT_S, frame_timeout_s=FRAME_TIMEOUT_S)
        self._last, self._pings_lost, self._restarts = None, 0, 0
        self._failed_configures = 0
        self._configure()

    def _configure(self) -> None:
        self._failed_configures += 1
        self._device.configure(self._settings)
        self._failed_configures = self._failed_pings = 0

    def _ping(self) -> int:
        self._failed_pings += 1
        asked_ns = time.time_ns()
        frame = self._device.ping()
        sent = self.ledger.judge(frame, self._codes)
        self.ledger.judge_time(frame, sent, asked_ns, time.time_ns())
        return self._good(sent)

    def _hear(self) -> int:
        self._failed_pings += 1
        if not self._edges:
            self._last_edge = len(self.ledger.sent) + 1
            for _ in range(2):
                self._emulator.trigger(1)
        self._edges = 0
        frame = self._device.wait_frame(TIMEOUT_S)
        sent = self.ledger.judge(frame, self._codes)
        self.ledger.judge_estimate(frame, sent, time.time_ns())
        self._edges = max(0, self._last_edge - sent.serial)
        return self._good(sent)

    def _good(self, sent: Sent) -> int:
        """What the device counts as lost is what the firmware counted and nobody got."""
        self._failed_pings = 0
        last, self._last = self._last, sent
        started_anew = self._device.restarts != self._restarts
        if last is not None and not started_anew and not (last.moved or sent.moved):
            self._pings_lost += sent.index - last.index - 1
            assert self._device.pings_lost == self._pings_lost, "lost pings miscounted"
        self._pings_lost, self._restarts = self._device.pings_lost, self._device.restarts
        return sent.serial
