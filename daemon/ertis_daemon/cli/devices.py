"""``ertis devices``: list the sonars that are plugged in."""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ertis_driver.discover import Identity, PluggedIn

HEADER = ("PORT", "SERIAL NUMBER", "USB", "PRODUCT", "STATE")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("--all", action="store_true", help="every tty, and why it is no sonar")
    parser.add_argument("--json", action="store_true", help="print a JSON array")
    parser.add_argument(
        "--usb-id",
        type=_usb_id,
        default=(0x0483, 0x5740),
        metavar="VID:PID",
        help="what a sonar's is, default 0483:5740",
    )
    parser.add_argument(
        "--product",
        default="eRTIS",
        metavar="TEXT",
        help="how a sonar's product string begins, default eRTIS; '' for any",
    )
    parser.epilog = "Exit code 1 if there is none. Only root sees who else holds a port."


def run(args: argparse.Namespace) -> int:
    """Print the table."""
    from ertis_driver.discover import Identity, plugged_in
    from ertis_driver.errors import DeviceNotFound

    vendor_id, product_id = args.usb_id
    identity = Identity(vendor_id, product_id, args.product)
    met = plugged_in()
    # Without a port it is of interest only as a sonar held by a usb: link.
    wanted = [d for d in met if not d.why_not(identity) or (args.all and d.port)]
    if args.json:
        print(json.dumps([_as_json(device, identity) for device in wanted], indent=2))
    elif wanted:
        _print_table([_row(device, identity) for device in wanted])
    if not wanted:
        raise DeviceNotFound(
            f"no sonar ({identity.usb_id}, product {identity.product!r}) is plugged in: check "
            "cable and power; `ertis devices --all` lists the other serial ports"
        )
    return 0


def _usb_id(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9a-fA-F]{1,4}):([0-9a-fA-F]{1,4})", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"{text!r}, expected VID:PID such as 0483:5740")
    return int(found[1], 16), int(found[2], 16)


def _state(device: PluggedIn, identity: Identity) -> str:
    reason = device.why_not(identity)
    if reason:
        return f"no sonar: {reason}"
    if device.holders:
        return "held by " + ", ".join(f"{its.pid} ({its.command})" for its in device.holders)
    if not device.may_open:
        return "no permission: `sudo make udev` and replug it, or join the group dialout"
    return "free" if device.port else "free, without a tty: use a usb: address"


def _row(device: PluggedIn, identity: Identity) -> tuple[str, ...]:
    return (
        device.port or device.usb_node,
        device.serial_number or "-",
        device.usb_id or "-",
        device.product or "-",
        _state(device, identity),
    )


def _as_json(device: PluggedIn, identity: Identity) -> dict[str, Any]:
    reason = device.why_not(identity)
    return dataclasses.asdict(device) | {
        "usb_id": device.usb_id,
        "is_sonar": not reason,
        "why_not": reason,
    }


def _print_table(rows: list[tuple[str, ...]]) -> None:
    rows = [HEADER, *rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEADER) - 1)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        print("  ".join([*cells, row[-1]]))
