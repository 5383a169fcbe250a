"""``ertis dataset``: make labelled data sets, check them, correct and count their labels."""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType

PARTS = {
    "record": "record labelled pings, one by one",
    "check": "find what is wrong with a data set",
    "relabel": "correct labels and other columns",
    "stats": "count what a data set holds, and draw it",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the parts and their flags."""
    parts = parser.add_subparsers(dest="part", metavar="PART", required=True)
    for name, text in PARTS.items():
        part = parts.add_parser(name, help=text, description=text)
        _module(name).add_arguments(part)


def run(args: argparse.Namespace) -> int:
    """Do what the part does."""
    return int(_module(args.part).run(args))


def _module(name: str) -> ModuleType:
    return importlib.import_module(f"ertis_daemon.cli.dataset_{name}")
