"""``ertis recover``: what is whole of a damaged recording."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.cli.quantities import size_text

if TYPE_CHECKING:
    from ertis_driver.recover import Recovery

OK, WITH_LOSS = 0, 3
_NAMED_HOLES = 10

EPILOG = """\
The file itself is not touched. Pings are saved only whole, with everything that belongs to them,
also those behind the damage.

for example
  ertis recover hall.mcap -o hall-saved.mcap

Exit code: 0 nothing was lost; 3 something was, and is counted.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("file", type=Path, help="damaged MCAP recording")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT", help="default FILE.recovered.mcap"
    )
    parser.add_argument("--json", action="store_true", help="print what came of it as JSON")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def run(args: argparse.Namespace) -> int:
    """Save what is whole."""
    from ertis_driver.recover import recover

    output = args.output or args.file.with_name(f"{args.file.stem}.recovered.mcap")
    recovery = recover(args.file, output)
    if args.json:
        told = dataclasses.asdict(recovery) | {"output": str(output)}
        print(json.dumps(told))
    else:
        print(output)
        _tell(recovery)
    lost = recovery.pings_lost or recovery.bytes_lost or recovery.info_lost
    return WITH_LOSS if lost else OK


def _tell(recovery: Recovery) -> None:
    for hole in recovery.holes[:_NAMED_HOLES]:
        where = f"bytes {hole.start} to {hole.end}" if hole.start >= 0 else "a ping"
        print(f"ertis: {where}: {hole.what}", file=sys.stderr)
    if len(recovery.holes) > _NAMED_HOLES:
        print(f"ertis: and {len(recovery.holes) - _NAMED_HOLES} more places", file=sys.stderr)
    if recovery.info_lost:
        print(
            "ertis: what the recording said about itself is lost: chirp, device, who made it",
            file=sys.stderr,
        )
    print(
        f"ertis: {recovery.num_pings} pings saved, {recovery.pings_lost} lost; "
        f"{recovery.other_messages} other messages saved; {size_text(recovery.bytes_lost)} of no "
        "use",
        file=sys.stderr,
    )
