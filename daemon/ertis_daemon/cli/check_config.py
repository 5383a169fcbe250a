"""``ertis check-config``: say what is wrong with a configuration, or print an example."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "file", type=Path, nargs="?", help="YAML; without it, an example is printed"
    )
    parser.add_argument("--json", action="store_true", help="print the effective values as JSON")


def run(args: argparse.Namespace) -> int:
    """Check and print; errors leave as ConfigError."""
    from ertis_daemon.config import Config, example_yaml, load_config
    from ertis_daemon.events import dump_json

    config = load_config(args.file) if args.file else Config()
    if args.json:
        print(dump_json(config.to_json()).decode())
    elif args.file:
        print(f"{args.file}: ok")
    else:
        print(example_yaml(config), end="")
    return 0
