"""A sonar that survives its cable."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings, Sonar
from ertis_driver.discover import pinned
from ertis_driver.errors import AddressError, DeviceError, DeviceLost, PingLost
from ertis_driver.frame import PdmFrame
from ertis_driver.open import open_device

log = logging.getLogger(__name__)

FIRST_PAUSE_S = 0.05
MAX_PAUSE_S = 0.5  # with opening and configuring, still under 2 s after the device is back


class ReconnectingSonar(Closing):
    """Hardware that is opened again when it was unplugged; implements ``Sonar``.

    When the device goes away it is closed at once, since a descriptor kept open makes it come back
    under another name. The ping under way is reported as ``PingLost``. The next ping looks for the
    device by its serial number, where it has one, opens and configures it as it was, and pings.
    Each change is logged once.

    Parameters
    ----------
    address
        ``serial:...`` or ``usb:...``. The device must be there now.
    settings
        To configure it with at once; else call ``configure``.
    patience_s
        How long one ping waits for the device to come back, s, before it is ``PingLost`` as well.
    options
        Passed on to the device.

    Attributes
    ----------
    reconnects : int
        How often it was opened again.

    Raises
    ------
    DeviceError, AddressError
        If it cannot be opened now.
    """

    def __init__(
        self,
        address: str,
        settings: Settings | None = None,
        *,
        patience_s: float = 1.0,
        **options: Any,
    ) -> None:
        self._address = pinned(address)
        self._given = address
        self._options = options
        self._patience_s = patience_s
        self._pause_s = FIRST_PAUSE_S
        self._lost_s = 0.0
        self._reason = ""
        self._closed = threading.Event()
        self._turn = threading.RLock()  # one ping or configuration at a time
        self._swap = threading.Lock()  # guards _sonar against close
        self.reconnects = 0
        self._sonar: Sonar | None = open_device(self._address, **options)
        self._info = replace(self._sonar.info, address=address)
        self._settings: Settings | None = None
        if settings is not None:
            try:
                self.configure(settings)
            except BaseException:
                self.close()
                raise

    @property
    def info(self) -> DeviceInfo:
        """Who answers, or answered last."""
        return self._info

    @property
    def settings(self) -> Settings | None:
        """What it is configured to do, and will be again when it is back."""
        return self._settings

    @property
    def is_live(self) -> bool:
        """Whether real hardware made the frames."""
        return self._info.source == "live"

    @property
    def is_connected(self) -> bool:
        """Whether the device was there when it was last needed."""
        return self._sonar is not None

    def configure(self, settings: Settings) -> None:
        """Send settings and chirp; they are sent again after each reconnection.

        Raises
        ------
        PingLost
            If the device is away; the settings are then sent when it is back.
        DeviceError
            If it does not answer as it should.
        """
        with self._turn:
            self._settings = settings
            reconnects = self.reconnects
            sonar = self._present()
            if self.reconnects > reconnects:
                return  # it was sent on the way
            try:
                sonar.configure(settings)
            except DeviceLost as error:
                raise self._went_away(sonar, error) from error
            except BaseException:
                self._settings = None
                raise

    def wait_connected(self) -> None:
        """Wait for the device if it is away, and open it again; does not ping.

        Raises
        ------
        PingLost
            If it was not back in time.
        DeviceLost
            After ``close``.
        """
        with self._turn:
            self._present()

    def ping(self, *, active: bool = True) -> PdmFrame:
        """Ping and wait for the frame, and before that for the device if it is away.

        Raises
        ------
        PingLost
            If the device went away during this ping, or was not back in time: ping again.
        DeviceLost
            After ``close``.
        NotConfigured, DeviceTimeout, FrameCorrupt
            As the device does.
        """
        return self._frame_of(lambda sonar: sonar.ping(active=active))

    def wait_frame(self, timeout_s: float) -> PdmFrame:
        """Return the next frame of the external trigger; wait for the device if it is away.

        Raises
        ------
        PingLost
            If the device went away meanwhile, or was not back in time: wait again.
        DeviceLost
            After ``close``.
        NotConfigured, DeviceTimeout, FrameCorrupt
            As the device does.
        """
        return self._frame_of(lambda sonar: sonar.wait_frame(timeout_s))

    def close(self) -> None:
        """Give the device back and end a wait for it. May be called twice, and from any thread."""
        self._closed.set()
        with self._swap:
            sonar, self._sonar = self._sonar, None
        if sonar is not None:
            sonar.close()

    def _frame_of(self, ask: Callable[[Sonar], PdmFrame]) -> PdmFrame:
        with self._turn:
            sonar = self._present()
            try:
                return ask(sonar)
            except DeviceLost as error:
                raise self._went_away(sonar, error) from error

    def _went_away(self, sonar: Sonar, error: DeviceLost) -> DeviceError:
        sonar.close()
        with self._swap:
            self._sonar = None
        if self._closed.is_set():
            return DeviceLost(f"{self._address} is closed: reopen it")
        self._lost_s = time.monotonic()
        self._pause_s = FIRST_PAUSE_S
        self._reason = ""
        log.warning("%s; looking for %s", error, self._address)
        return PingLost(f"{error}; it is opened again when it is back: ping again")

    def _present(self) -> Sonar:
        """Return the device, opened again if need be."""
        end_s = time.monotonic() + self._patience_s
        while not self._closed.is_set():
            sonar = self._sonar
            if sonar is not None:
                return sonar
            try:
                self._reopen()
                continue
            except (DeviceError, AddressError) as error:
                reason = f"{type(error).__name__}: {error}"
                if reason != self._reason:
                    log.info("%s is not back: %s", self._address, reason)
                self._reason = reason
                self._closed.wait(self._pause_s)
                self._pause_s = min(2 * self._pause_s, MAX_PAUSE_S)
                if time.monotonic() >= end_s and not self._closed.is_set():
                    away_s = time.monotonic() - self._lost_s
                    raise PingLost(
                        f"{self._address} has been away for {away_s:.1f} s ({error}); ping again"
                    ) from error
        raise DeviceLost(f"{self._address} is closed: reopen it")

    def _reopen(self) -> None:
        sonar = open_device(self._address, **self._options)
        try:
            if self._settings is not None:
                sonar.configure(self._settings)
        except BaseException:
            sonar.close()
            raise
        with self._swap:
            if not self._closed.is_set():
                self._sonar = sonar
                self._info = replace(sonar.info, address=self._given)
                self.reconnects += 1
                away_s = time.monotonic() - self._lost_s
                log.warning("%s is back after %.1f s", self._address, away_s)
                return
        sonar.close()
