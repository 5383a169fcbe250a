"""``ertis doctor``: what works here, what is missing, what to do."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

_MARKS = {"ok": "ok", "missing": "--", "wrong": "!!"}

EPILOG = """\
Looks at Python, BLAS threads, extras, sonars with their permissions and holders, the udev rule,
ModemManager, the model against the settings, a Zenoh router, free disk and the clock. Changes
nothing and opens no sonar.

example:
  ertis doctor --config /etc/ertis/ertis.yaml

Exit code: 0 nothing is wrong (something may be missing: --), 3 something is (!!).
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("--config", type=Path, metavar="FILE", help="the daemon's configuration")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Print what was found."""
    import dataclasses

    from ertis_daemon.checkup import check_all
    from ertis_daemon.config import Config
    from ertis_daemon.config_read import load_config

    config = load_config(args.config) if args.config else Config()
    checks = check_all(config)
    is_wrong = any(check.state == "wrong" for check in checks)
    if args.json:
        said = {"checks": [dataclasses.asdict(check) for check in checks], "healthy": not is_wrong}
        print(json.dumps(said))
        return 3 if is_wrong else 0
    for check in checks:
        print(f"{_MARKS[check.state]}  {check.name:<13} {check.said}")
        if check.todo:
            print(f"{'':17} -> {check.todo}")
    return 3 if is_wrong else 0
