"""``ertis check-config``: say what is wrong with a configuration, or print an example."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        help="YAML, checked together with what run --config FILE would lay it over; without it, an "
        "example is printed",
    )
    parser.add_argument(
        "--json", action="store_true", help="print the effective values of all layers as JSON"
    )


def run(args: argparse.Namespace) -> int:
    """Check and print; errors leave as ConfigError, or as the detector's for a model."""
    from ertis_daemon.config import example_yaml
    from ertis_daemon.events import dump_json
    from ertis_daemon.layers import Sources
    from ertis_daemon.serving.reload import check_folders, check_models

    if not args.file and not args.json:
        print(example_yaml(), end="")
        return 0
    sources = Sources(args.file)
    config = sources.load()
    check_models(config.each_sonar())
    check_folders(config.each_sonar())
    if args.json:
        print(dump_json(config.to_json()).decode())
        return 0
    for path in sources.files():
        print(f"{path}: ok")
    return 0
