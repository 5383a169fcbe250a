"""``ertis convert``: recordings into other formats, and back."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.cli.quantities import size_text

if TYPE_CHECKING:
    from ertis_driver.chirp import Emission

EPILOG = """\
The suffix of OUT says what is made:
  .mcap  a recording; pings, truth and what is known about them
  .bin   headerless uint32 PDM words, as the incumbent's client writes and reads them
  .wav   audio at 450 kHz, 32 channels of float32, ping after ping; RF64 from 4 GB on
  .csv   the events of a recording, a landmark a row

for example
  ertis convert session/*.bin session.mcap --chirp hyperbolic:50000:25000:0.0025
  ertis convert hall.mcap hall.wav --pings 0:10
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="MCAP, or raw words")
    parser.add_argument("output", type=Path, metavar="OUT", help="file to make")
    parser.add_argument(
        "--pings", default=":", metavar="FROM:TO", help="by place from 0, TO left out; default all"
    )
    parser.add_argument(
        "--chirp",
        metavar="KIND:START:STOP:SECONDS",
        help="of a file that does not say; default: heard from the direct path",
    )
    parser.add_argument("--compress", action="store_true", help="the frames of an .mcap")
    parser.add_argument("--json", action="store_true", help="print what was made as JSON")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def run(args: argparse.Namespace) -> int:
    """Convert."""
    from ertis_daemon.recordings.convert import Choice, convert
    from ertis_daemon.recordings.event_table import write_event_table
    from ertis_driver.errors import RecordingError, SettingsError

    if args.compress and args.output.suffix != ".mcap":
        raise SettingsError("--compress is for .mcap: leave it out")
    if args.output.suffix == ".csv":
        if len(args.files) > 1:
            raise RecordingError("events of one recording a table: name one file")
        count, what = write_event_table(args.files[0], args.output), "landmarks"
    else:
        start, stop = _range(args.pings)
        choice = Choice(start, stop, _chirp(args), args.compress)
        count, what = convert(args.files, args.output, choice), "pings"
        _warn_of_loss(args)
    size = args.output.stat().st_size
    if args.json:
        print(json.dumps({"output": str(args.output), what: count, "bytes": size}))
    else:
        print(f"{args.output}: {count} {what}, {size_text(size)}")
    return 0


def _range(text: str) -> tuple[int, int | None]:
    from ertis_driver.errors import SettingsError

    first, colon, last = text.partition(":")
    try:
        start = int(first or 0)
        stop = int(last) if last else None if colon else start + 1
        if start < 0 or (stop is not None and stop <= start):
            raise ValueError
    except ValueError as error:
        raise SettingsError(f"--pings {text}, expected FROM:TO such as 0:10, or one") from error
    return start, stop


def _chirp(args: argparse.Namespace) -> Emission | None:
    """What a recording is to be told of its chirp, if it does not know."""
    from ertis_driver.chirp import Chirp
    from ertis_driver.recording import open_recording

    if args.chirp:
        return Chirp.parse(args.chirp)
    first = open_recording(args.files[0])
    if args.output.suffix == ".bin" or first.info.chirp is not None:
        return None
    from ertis_daemon.chirp_guess import guess_chirp
    from ertis_driver.audio import PdmDecoder, whole_samples

    for ping in first:
        chirp = guess_chirp(PdmDecoder().decode(whole_samples(ping.frame.words)).audio)
        said = f"its direct path sounds like {chirp.name}" if chirp else "none is heard in it"
        print(
            f"ertis: {args.files[0]} says no chirp; {said}; --chirp names another", file=sys.stderr
        )
        return chirp
    return None


def _warn_of_loss(args: argparse.Namespace) -> None:
    from ertis_driver.mcap_summary import read_summary
    from ertis_driver.recording import open_recording

    for path in args.files:
        info = open_recording(path).info
        if args.output.suffix == ".bin" and info.chirp is not None:
            print(
                f"ertis: {args.output} holds words only: chirp, times, temperature and source "
                f"({info.source}) stay behind",
                file=sys.stderr,
            )
        summary = read_summary(path)
        others = summary.num_messages if summary is not None else {}
        count = sum(others.get(topic, 0) for topic in ("events", "picture", "log"))
        if count:
            print(
                f"ertis: {path}: {count} events, pictures and lines of log stay behind",
                file=sys.stderr,
            )
