"""What is wrong with a long command's options is said before its work, not after it."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from ertis_driver.errors import ErtisError, SettingsError


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Declare the flag that ``check_workers`` looks at."""
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="default: every core"
    )


def check_workers(count: int) -> None:
    """Raise SettingsError if nobody would work."""
    if count < 1:
        raise SettingsError(f"--workers {count}, expected 1 at least")


def check_air(temperature_c: float | None, humidity_percent: float | None) -> None:
    """Raise SettingsError if no air is like that; None is not known."""
    if temperature_c is not None and not -60 <= temperature_c <= 80:
        raise SettingsError(f"--temperature-c {temperature_c:g}, expected -60 to 80")
    if humidity_percent is not None and not 0 <= humidity_percent <= 100:
        raise SettingsError(f"--humidity-percent {humidity_percent:g}, expected 0 to 100")


def check_output(path: Path, *, may_be_folder: bool = False) -> None:
    """Raise ErtisError if there is no folder for a file, or a folder in its place."""
    if not path.parent.is_dir() or (path.is_dir() and not may_be_folder):
        raise ErtisError(f"cannot write {path}: name a file in a folder that exists")
