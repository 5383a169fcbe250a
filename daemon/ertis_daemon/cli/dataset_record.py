"""``ertis dataset record``: labelled pings, one by one."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ertis_daemon.dataset.judge import Judgement
    from ertis_daemon.dataset.session import Tally
    from ertis_driver.chirp import Chirp
    from ertis_driver.dataset import DatasetRow

EPILOG = """\
Asks where this is, by whom and how warm the air is, then what stands where; after that
Enter pings and ? lists the other words. What was said last is kept, also from run to run.
Each ping is on the disk when its line is printed. Answers may come from a pipe.

Example:
  ertis dataset record ~/sonar-data --address serial:/dev/ttyACM0

Exit code: 0 all pings good, 3 some doubtful or not heard, 1 the sonar or the disk failed.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="data set, new or begun")
    parser.add_argument(
        "--address",
        default="serial:/dev/ertis0",
        help="of the sonar, default serial:/dev/ertis0; sim:SCENE.yaml to try it out",
    )
    parser.add_argument(
        "--chirp", metavar="KIND:START:STOP:SECONDS", help="default hyperbolic:80000:20000:0.0025"
    )
    parser.add_argument("--json", action="store_true", help="a JSON object for each ping")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Ask and ping until the answers end."""
    from ertis_daemon.dataset.lock import locked
    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.errors import DatasetError

    chirp = Chirp.parse(args.chirp) if args.chirp else DEFAULT_CHIRP
    try:
        new = [path for path in (args.folder, *args.folder.parents) if not path.exists()]
        args.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"cannot make {args.folder}: {error.strerror}") from error
    with locked(args.folder):
        try:
            return _record(args, chirp)
        finally:
            _remove_unused(args.folder, new)


def _record(args: argparse.Namespace, chirp: Chirp) -> int:
    from ertis_daemon.dataset.dialog import Dialog
    from ertis_daemon.dataset.recorder import DatasetRecorder
    from ertis_daemon.dataset.session import Session
    from ertis_driver.device import Settings
    from ertis_driver.open import open_device

    with open_device(args.address, reconnect=True) as sonar:
        sonar.configure(Settings(chirp))
        recorder = DatasetRecorder(args.folder)
        for line in recorder.resumed:
            _say(f"resumed: {line}")
        show = _show_json if args.json else _show_text
        session = Session(recorder, sonar, Dialog(_ask, _say), _say, show)
        try:
            session.run()
        finally:
            _say(_summary(session.tally, len(recorder.rows), sonar.info.source))
    return 3 if session.tally.doubtful or session.tally.failed else 0


def _remove_unused(folder: Path, new: list[Path]) -> None:
    """Remove the lock, and the folders that are new, where nothing else came to be."""
    from ertis_daemon.dataset.lock import LOCK

    with suppress(OSError):
        if [path.name for path in folder.iterdir()] == [LOCK]:
            (folder / LOCK).unlink()
            for path in new:
                path.rmdir()


def _ask(prompt: str) -> str | None:
    print(prompt, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line or not sys.stdin.isatty():
        print(line.rstrip("\n"), file=sys.stderr)  # what a pipe answers is not echoed otherwise
    return line or None


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _show_json(row: DatasetRow, judgement: Judgement) -> None:
    from ertis_daemon.dataset.session import as_json

    print(json.dumps(as_json(row, judgement)), flush=True)


def _show_text(row: DatasetRow, judgement: Judgement) -> None:
    from ertis_daemon.dataset.session import as_text

    print(as_text(row, judgement), flush=True)


def _summary(tally: Tally, total: int, source: str) -> str:
    kind = {"live": "", "sim": "simulated ", "replay": "replayed "}[source]
    parts = [f"{tally.recorded} {kind}pings recorded"]
    parts += [f"{tally.undone} undone"] if tally.undone else []
    parts += [f"{len(tally.doubtful)} doubtful"] if tally.doubtful else []
    parts += [f"{tally.failed} not heard"] if tally.failed else []
    return f"{', '.join(parts)}; {total} in the data set"
