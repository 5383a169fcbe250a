"""From an address such as ``serial:/dev/ttyACM0`` to a device."""

from __future__ import annotations

from importlib import import_module
from typing import Any, cast

from ertis_driver.device import Sonar
from ertis_driver.errors import AddressError

# Names, not imports: a replay must not need pyserial, nor the driver the simulator.
KINDS: dict[str, str] = {
    "serial": "ertis_driver.ertis_device:open_serial",
    "usb": "ertis_driver.usb_device:open_usb",
    "replay": "ertis_driver.replay_device:open_replay",
    "sim": "ertis_simulator.device:open_sim",
}
HARDWARE = ("serial", "usb")
EXAMPLES = "serial:/dev/ttyACM0, usb:0483:5740, replay:garage.mcap, sim:hall.yaml"


def split_address(address: str) -> tuple[str, str]:
    """Kind of device, and where; nothing is looked for there.

    Raises
    ------
    AddressError
        If the address is malformed or of a kind that is unknown.
    """
    kind, colon, where = address.partition(":")
    if not colon or not where:
        hint = f"; did you mean serial:{address}?" if address.startswith("/dev/") else ""
        raise AddressError(f"address {address!r}, expected kind:where ({EXAMPLES}){hint}")
    if kind not in KINDS:
        raise AddressError(
            f"address {address!r} is of unknown kind {kind!r}, expected one of {', '.join(KINDS)} "
            f"({EXAMPLES})"
        )
    return kind, where


def is_hardware(address: str) -> bool:
    """Whether a sonar is there, rather than a recording or a simulation."""
    return address.startswith(tuple(f"{kind}:" for kind in HARDWARE))


def open_device(address: str, *, reconnect: bool = False, **options: Any) -> Sonar:
    """Open the sonar at ``kind:where``.

    Parameters
    ----------
    address
        ``serial:PORT``, ``serial:sn=NUMBER``, ``usb:VID:PID``, ``usb:VID:PID:NUMBER``,
        ``usb:sn=NUMBER``, ``replay:RECORDING`` or ``sim:SCENE``. NUMBER is the device's own serial
        number, which a replug does not change, as it may change the port.
    reconnect
        Whether hardware that was unplugged is opened again; see ``ReconnectingSonar``. A recording
        or simulation cannot go away: there it changes nothing.
    options
        Passed on to that kind of device.

    Raises
    ------
    AddressError
        If the address is malformed or of a kind that is unknown or not installed.
    DeviceError, RecordingError
        If the device or recording cannot be opened.
    """
    kind, where = split_address(address)
    name = KINDS[kind]
    if reconnect and is_hardware(address):
        name, where = "ertis_driver.reconnect:ReconnectingSonar", address
    module_name, _, factory_name = name.partition(":")
    try:
        factory = getattr(import_module(module_name), factory_name)
    except ImportError as error:
        raise AddressError(
            f"address {address!r}: kind {kind!r} is not usable here ({error})"
        ) from error
    return cast(Sonar, factory(where, **options))
