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


def check_output(path: Path, *, may_be_folder: bool = False) -> None:
    """Raise ErtisError if there is no folder for a file, or a folder in its place."""
    if not path.parent.is_dir() or (path.is_dir() and not may_be_folder):
        raise ErtisError(f"cannot write {path}: name a file in a folder that exists")
