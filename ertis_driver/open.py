"""From an address such as ``serial:/dev/ttyACM0`` to a device."""

from __future__ import annotations

from importlib import import_module
from typing import Any, cast

from ertis_driver.device import Sonar
from ertis_driver.errors import AddressError

# Names, not imports: a replay must not need pyserial, nor the driver the simulator.
KINDS: dict[str, str] = {
    "serial": "ertis_driver.ertis_device:open_serial",
    "replay": "ertis_driver.replay_device:open_replay",
    "sim": "ertis_simulator.device:open_sim",
}
EXAMPLES = "serial:/dev/ttyACM0, replay:garage.mcap, sim:hall.yaml"


def open_device(address: str, **options: Any) -> Sonar:
    """Open the sonar at ``kind:where``.

    Parameters
    ----------
    address
        ``serial:PORT``, ``replay:RECORDING`` or ``sim:SCENE``.
    options
        Passed on to that kind of device.

    Raises
    ------
    AddressError
        If the address is malformed or of a kind that is unknown or not installed.
    DeviceError, RecordingError
        If the device or recording cannot be opened.
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
    module_name, _, factory_name = KINDS[kind].partition(":")
    try:
        factory = getattr(import_module(module_name), factory_name)
    except ImportError as error:
        raise AddressError(
            f"address {address!r}: kind {kind!r} is not usable here ({error})"
        ) from error
    return cast(Sonar, factory(where, **options))
