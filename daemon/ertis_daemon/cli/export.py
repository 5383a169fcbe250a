"""``ertis export``: files for other programs."""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType

PARTS = {
    "landmark": "a landmark, or a plate that holds several, for a 3D printer",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the parts and their flags."""
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    for name, text in PARTS.items():
        part = parts.add_parser(name, help=text, description=text)
        _module(name).add_arguments(part)
    parser.epilog = "Example:\n  ertis export landmark --radius 48 -o r48.stl\n"


def run(args: argparse.Namespace) -> int:
    """Do what the part does."""
    return int(_module(args.part).run(args))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"ertis_daemon.cli.export_{name}")
