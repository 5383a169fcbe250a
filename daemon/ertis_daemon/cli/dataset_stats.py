"""``ertis dataset stats``: how much of what a data set holds."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ertis_daemon.cli.before_work import check_output

EPILOG = """\
Example:
  ertis dataset stats ~/sonar-data --plot stats.png
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="data set")
    parser.add_argument("--plot", type=Path, metavar="OUT.png", help="draw it, too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Print the counts."""
    from ertis_daemon.dataset.stats import as_lines, statistics
    from ertis_driver.dataset import open_dataset

    if args.plot is not None:
        check_output(args.plot)
    dataset = open_dataset(args.folder)
    told = statistics(dataset)
    if args.plot is not None:
        from ertis_daemon.dataset.stats_plot import draw_statistics

        draw_statistics(dataset, told, args.plot)
    print(json.dumps(told) if args.json else "\n".join(as_lines(told)))
    return 0
