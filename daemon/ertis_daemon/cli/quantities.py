"""Sizes and times as people write them."""

from __future__ import annotations

import argparse
import math

_BYTES = {"": 1, "B": 1}
_BYTES |= {f"{prefix}B": 1000**n for n, prefix in enumerate("KMGT", 1)}
_BYTES |= {f"{prefix}IB": 1024**n for n, prefix in enumerate("KMGT", 1)}
_SECONDS = {"": 1.0, "S": 1.0, "MS": 1e-3, "MIN": 60.0, "H": 3600.0}


def size_bytes(text: str) -> int:
    """A size in bytes.

    >>> size_bytes("1GB"), size_bytes("512 MiB"), size_bytes("2.5kB")
    (1000000000, 536870912, 2500)
    """
    return round(_quantity(text, _BYTES, "a size such as 1GB, 500MB or 2GiB"))


def time_s(text: str) -> float:
    """A time in seconds.

    >>> time_s("30s"), time_s("1.5min"), time_s("250ms"), time_s("2")
    (30.0, 90.0, 0.25, 2.0)
    """
    return _quantity(text, _SECONDS, "a time such as 30s, 5min or 1h")


def size_text(num_bytes: float) -> str:
    """A size for people.

    >>> size_text(1_312_000_000), size_text(655_372), size_text(12)
    ('1.31 GB', '655 kB', '12 B')
    """
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if num_bytes >= factor:
            return f"{num_bytes / factor:.3g} {unit}"
    return f"{num_bytes:.0f} B"


def _quantity(text: str, units: dict[str, int] | dict[str, float], expected: str) -> float:
    number = text.strip().rstrip("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ")
    unit = text.strip()[len(number) :].upper()
    try:
        value = float(number) * units[unit]
    except (ValueError, KeyError) as error:
        raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}") from error
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text!r}, expected more than nothing, {expected}")
    return value
