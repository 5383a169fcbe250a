"""What the device is told, in the order in which it wants it."""

from __future__ import annotations

import logging

from ertis_driver import protocol
from ertis_driver.device import TRIGGER_PINS, ExternalTrigger, Settings
from ertis_driver.errors import DeviceTimeout, DeviceUnsupported, OutOfStep, WrongDevice
from ertis_driver.exchanges import Exchanges
from ertis_driver.frame import AUDIBLE_PDM_RATE_HZ
from ertis_driver.protocol import encode_command
from ertis_driver.upload import ChirpMemory, Progress

log = logging.getLogger(__name__)

LEAVE_S = 0.1  # a device that takes no more bytes must not hold up who leaves it


class Registers:
    """The device's settings.

    Amplifier and external trigger are off when it boots: they are switched off only if this
    session switched them on.

    Parameters
    ----------
    exchanges
        The way to the device.
    progress
        Called while a chirp is uploaded.
    """

    def __init__(self, exchanges: Exchanges, progress: Progress | None = None) -> None:
        self._exchanges = exchanges
        self._name = exchanges.link.name
        self._chirp_memory = ChirpMemory(exchanges, progress)
        self._amplifier_on = False
        self._amplifier_missing = False
        self._trigger_on: ExternalTrigger | None = None
        self.version_word = 0

    def identify(self, patience_s: float) -> int:
        """Ask for the version word, whatever was going on before.

        Raises
        ------
        DeviceTimeout, DeviceLost, DeviceBabbles, WrongDevice
        """
        if self._trigger_on is not None:
            self._exchanges.write(encode_command("J", 0, self._trigger_on.pin), LEAVE_S)
            self._exchanges.fence(self.version_word, patience_s)
            self._trigger_on = None
        self._exchanges.settle(patience_s)
        try:
            word = self._version()
            if word == protocol.HEADER:
                # A frame that its former user did not wait for, or left a trigger on for.
                for pin in TRIGGER_PINS:
                    self._exchanges.write(encode_command("J", 0, pin), LEAVE_S)
                self._exchanges.settle(patience_s)
                word = self._version()
            protocol.parse_source(word)
        except DeviceTimeout as error:
            raise DeviceTimeout(
                f"no answer in {self._exchanges.timeout_s:g} s at {self._name}: not an eRTIS, or "
                "it hangs; check the port name, or replug it"
            ) from error
        except WrongDevice as error:
            raise WrongDevice(f"{self._name}: {error}; name another port") from error
        self.version_word = word
        return word

    def set(self, settings: Settings, version: int) -> None:
        """Send all of them, and make sure that each was answered.

        Raises
        ------
        DeviceUnsupported, UploadFailed, OutOfStep, DeviceTimeout, DeviceLost
        """
        codes = settings.chirp.dac_codes()
        audible = settings.pdm_rate_hz == AUDIBLE_PDM_RATE_HZ
        self._exchanges.command(protocol.encode_frame_size(settings.num_words))
        self._command("F", int(audible))
        self._command("D", settings.chirp.dac_rate_hz)
        self._command("E", len(codes))
        self._chirp_memory.put(codes)
        self._command("I", settings.emissions)
        if settings.first_ping_index is not None:
            self._command("B", settings.first_ping_index)
        self._set_amplifier(settings.amplifier)
        # Before a frame can come unasked: a byte too few or too many shifts each answer.
        met = self._command("Y")
        if met != version:
            raise OutOfStep(
                f"{self._name} answered out of step (version 0x{met:08x}, expected "
                f"0x{version:08x}): configure it again"
            )
        self._set_trigger(settings.external_trigger)

    def forget(self) -> None:
        """Trust nothing: the device may have restarted."""
        self.forget_chirp()
        self._amplifier_on = False
        self._trigger_on = None

    def forget_chirp(self) -> None:
        """Send the chirp next time, whatever was sent before."""
        self._chirp_memory.forget()

    def leave(self) -> None:
        """Switch off what this session switched on, without waiting for an answer."""
        commands = b""
        if self._trigger_on is not None:
            commands += encode_command("J", 0, self._trigger_on.pin)
        if self._amplifier_on:
            commands += encode_command("K", 0)
        self.forget()
        if commands:
            self._exchanges.write(commands, LEAVE_S)

    def _version(self) -> int:
        """Ask twice: the first time may complete a line that somebody left half-written."""
        half_s = self._exchanges.timeout_s / 2
        try:
            return self._exchanges.command(encode_command("Y"), half_s)
        except DeviceTimeout:
            word = self._exchanges.command(encode_command("Y"), half_s)
            self._exchanges.settle(self._exchanges.timeout_s)  # perhaps both were answered, late
            return word

    def _command(self, letter: str, *args: int) -> int:
        return self._exchanges.command(encode_command(letter, *args))

    def _set_amplifier(self, wanted: bool | None) -> None:
        on = wanted is not False
        if on == self._amplifier_on or (wanted is None and self._amplifier_missing):
            return
        try:
            reply = self._command("K", int(on))
        except DeviceTimeout:
            if wanted is not None:
                raise
            reply = 0  # firmware that never heard of it
        if on and reply == 0:
            if wanted is None:
                log.info("%s: its firmware has no amplifier step-up", self._name)
                self._amplifier_missing = True
                return
            raise DeviceUnsupported(
                f"the firmware of {self._name} has no amplifier step-up (K): configure it with "
                "amplifier=None or False"
            )
        self._amplifier_on = on

    def _set_trigger(self, trigger: ExternalTrigger | None) -> None:
        if trigger is None:
            return
        self._command("H", int(trigger.active))
        if self._command("J", 1, trigger.pin) == 0:
            raise DeviceUnsupported(
                f"the firmware of {self._name} has no external trigger (J): configure it with "
                "external_trigger=None and ping"
            )
        self._trigger_on = trigger
