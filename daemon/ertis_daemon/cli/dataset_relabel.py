"""``ertis dataset relabel``: correct rows of the table, with a line in the journal for each."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

EPILOG = """\
The recordings stay as they are, and with them what was said at the time; journal.jsonl says
what was corrected and when. A label that is given again counts as confirmed for
`ertis dataset check`.

Examples:
  ertis dataset relabel ~/sonar-data garage/s1/0007_r48.mcap --label r58
  ertis dataset relabel ~/sonar-data 'garage/s2/*' --set quality=bad --set note='door was open'

Exit code: 0 done, 1 nothing was changed.
"""
_FLAGS = ("label", "range_m", "azimuth_deg", "yaw_deg", "environment", "session", "quality")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="data set")
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="as in the table, or a pattern such as 'garage/s1/*'",
    )
    parser.add_argument("--label", help="r35 r48 r58 r70 or none")
    parser.add_argument("--range", dest="range_m", metavar="M", help="range, m")
    parser.add_argument("--azimuth", dest="azimuth_deg", metavar="DEG", help="bearing, + left")
    parser.add_argument("--yaw", dest="yaw_deg", metavar="DEG", help="turn of the dish, + left")
    parser.add_argument("--environment", metavar="NAME", help="where")
    parser.add_argument("--session", metavar="NAME", help="in which run")
    parser.add_argument("--quality", metavar="WORDS", help="good, or what is wrong")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="COLUMN=TEXT",
        help="any column, also one of your own",
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would change")
    parser.add_argument("--json", action="store_true", help="a JSON object for each row")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Change the rows."""
    from ertis_daemon.dataset.lock import locked
    from ertis_daemon.dataset.relabel import apply, changed, differences, select
    from ertis_driver.dataset import open_dataset

    values = _values(args)
    open_dataset(args.folder)  # before a lock is put where no data set is
    with locked(args.folder):
        dataset = open_dataset(args.folder)
        before = select(dataset, args.recordings)
        after = [changed(row, values) for row in before]
        if not args.dry_run:
            apply(dataset, after)
    for old, new in zip(before, after, strict=True):
        told = differences(old, new)
        if args.json:
            print(json.dumps({"file_name": old.file_name, "changes": told}))
        else:
            each = ", ".join(f"{name} {_said(a)} -> {_said(b)}" for name, (a, b) in told.items())
            print(f"{old.file_name}: {each or 'as before, confirmed'}")
    return 0


def _values(args: argparse.Namespace) -> dict[str, str]:
    from ertis_driver.errors import SettingsError

    values = {name: getattr(args, name) for name in _FLAGS if getattr(args, name) is not None}
    for pair in args.set:
        name, equals, text = pair.partition("=")
        if not equals:
            raise SettingsError(f"--set {pair}, expected COLUMN=TEXT")
        values[name.strip()] = text
    if not values:
        raise SettingsError("nothing to change: give --label, --range or another flag")
    return values


def _said(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return str(value) if value else "nothing"
