"""``ertis dataset check``: find what is wrong with a data set."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ertis_daemon.dataset.finding import Finding

EPILOG = """\
Looks for missing, stray, changed and damaged recordings, duplicates, labels that differ from what
was said when the ping was recorded, echoes that are not where their label says, dead microphones,
classes that are rare in an environment, and sessions that leak from one environment into another.

Example:
  ertis dataset check ~/sonar-data --json | jq '.findings[] | select(.kind == "echo")'

Exit code: 0 nothing found, 3 findings, 1 it could not be checked.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="data set")
    parser.add_argument(
        "--no-audio", action="store_true", help="look at the table and file names only: instantly"
    )
    parser.add_argument(
        "-j", "--workers", type=int, metavar="N", help="processes, default one for each core"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Print the findings."""
    import dataclasses

    from ertis_daemon.dataset.checks import check_heard, check_table
    from ertis_driver.dataset import manifest_hash, read_table
    from ertis_driver.errors import DatasetError, SettingsError

    if args.workers is not None and args.workers < 1:
        raise SettingsError(f"--workers {args.workers}, expected 1 or more")
    table = read_table(args.folder)
    found = check_table(args.folder, table)
    if not args.no_audio:
        from ertis_daemon.dataset.heard import hear_all

        workers = min(args.workers or os.cpu_count() or 1, max(1, len(table.rows) // 8))
        total = len(table.rows)
        heard = hear_all(args.folder, table.rows, workers, lambda done: _progress(done, total))
        found += check_heard(args.folder, table.rows, heard)
    try:
        manifest = manifest_hash(args.folder, table.rows)
    except DatasetError:
        manifest = ""  # a file without hash is missing: that is a finding already
    if args.json:
        said = {
            "folder": str(args.folder),
            "pings": len(table.rows),
            "manifest_hash": manifest,
            "findings": [dataclasses.asdict(one) for one in found],
        }
        print(json.dumps(said))
    else:
        for one in found:
            print(_line(args.folder, one))
        many = f"{len(found)} finding{'s' * (len(found) != 1)}" if found else "nothing found"
        print(f"{args.folder}: {len(table.rows)} pings, {many}, manifest {manifest[:12]}")
    return 3 if found else 0


def _line(folder: Path, one: Finding) -> str:
    where = f"{folder / 'metadata.csv'}:{one.line}: " if one.line else ""
    name = f"{one.file_name}: " if one.file_name else ""
    return f"{one.kind:<12} {where}{name}{one.text}"


def _progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        end = "\n" if done == total else ""
        print(f"\rheard {done}/{total}", end=end, file=sys.stderr, flush=True)
