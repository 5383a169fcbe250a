"""``ertis record``: a sonar's pings into a file."""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.before_work import check_air, check_output
from ertis_daemon.cli.quantities import size_bytes, size_text, time_s
from ertis_daemon.cli.signals import stop_on_signals

if TYPE_CHECKING:
    from ertis_daemon.recordings.session import SessionReport
    from ertis_driver.device import Settings, Sonar
    from ertis_driver.recording import RecordingInfo, RecordingWriter
    from ertis_driver.split_recording import SplitRecording

OK, FAILED, WITH_LOSS, INTERRUPTED = 0, 1, 3, 130
MAX_PINGS = 10**9
_PROGRESS_PERIOD_S = 0.2

EPILOG = """\
On a terminal one line shows how it goes: pings, rate, size, level of the direct path, microphones
that clip after it or do not work, pings lost. Five pings a second are looked at and drawn.
Ctrl-C ends it and closes the file.

for example
  ertis record hall.mcap --address serial:/dev/ttyACM0 -t 30s --who Ada --where "hall, east wall"
  ertis record night.mcap --split 1GB --compress

Exit code: 0 all is recorded; 3 pings were lost or the disk became full: what is written is kept;
1 the sonar failed; 130 Ctrl-C.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("output", type=Path, help="MCAP file to make; nothing is overwritten")
    parser.add_argument("-n", "--pings", type=int, metavar="N", help="end after N pings")
    parser.add_argument("-t", "--time", type=time_s, metavar="T", help="end after 30s, 5min, 1h")
    parser.add_argument(
        "--split", type=size_bytes, metavar="SIZE", help="files of 1GB each: OUT_001, OUT_002, ..."
    )
    parser.add_argument(
        "--compress", action="store_true", help="a third smaller, 10 ms of a core a ping"
    )
    _add_sonar_arguments(parser)
    for flag, text in (
        ("--who", "who records"),
        ("--where", "where, in words"),
        ("--note", "what for"),
        ("--licence", "what others may do with it, for example CC-BY-4.0"),
    ):
        parser.add_argument(flag, default="", metavar="TEXT", help=f"{text}; kept in the file")
    parser.add_argument(
        "--no-pictures", action="store_true", help="no energyscapes for Foxglove and Rerun"
    )
    parser.add_argument(
        "--sync",
        type=time_s,
        default=5.0,
        metavar="T",
        help="wait for the disk so often: what a loss of power costs; default 5s",
    )
    parser.add_argument("--json", action="store_true", help="print what came of it as JSON")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def _add_sonar_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--address",
        default="serial:/dev/ertis0",
        metavar="A",
        help="sonar, default serial:/dev/ertis0; also usb:, replay: and sim:",
    )
    parser.add_argument(
        "--chirp", metavar="KIND:START:STOP:SECONDS", help="default hyperbolic:80000:20000:0.0025"
    )
    parser.add_argument(
        "--words", type=int, metavar="N", help="PDM words a ping, default 163840: 36.4 ms, 6.2 m"
    )
    parser.add_argument(
        "--rate", type=float, default=0.0, metavar="HZ", help="pings a second, default all it can"
    )
    parser.add_argument("--passive", action="store_true", help="listen only, emit nothing")
    parser.add_argument(
        "--temperature-c", type=float, metavar="T", help="of the air, kept in the file"
    )
    parser.add_argument(
        "--humidity-percent", type=float, metavar="H", help="of the air, relative; the same"
    )


def run(args: argparse.Namespace) -> int:
    """Record until enough, Ctrl-C, or the sonar or the disk ends it."""
    from ertis_daemon.recordings.looking import Looker
    from ertis_daemon.recordings.session import Session
    from ertis_detector.air import Air
    from ertis_driver.open import open_device

    settings = _settings(args)
    with ExitStack() as stack:
        flag = stack.enter_context(stop_on_signals())
        sonar = stack.enter_context(open_device(args.address, reconnect=True))
        sonar.configure(settings)
        settings = sonar.settings or settings  # a recording keeps its own
        air = Air.measured(args.temperature_c, args.humidity_percent)
        looker = Looker(settings, air, sonar.info.source, pictures=not args.no_pictures)
        writer = _writer(args, _info(args, sonar, settings))
        stack.callback(writer.close)
        if looker.why_no_pictures:
            print(f"ertis: no pictures: {looker.why_no_pictures}", file=sys.stderr)
        line = _LiveLine(writer)
        session = Session(
            sonar,
            writer,
            flag.event,
            looker=looker,
            max_pings=args.pings or 0,
            max_s=args.time or 0.0,
            rate_hz=args.rate,
            active=not args.passive,
            progress=line.show,
        )
        try:
            report = session.run()
        finally:
            line.end()
        _close(writer, report)
    _tell(args, writer, report, looker)
    if report.ended == "failed":
        return FAILED
    if not report.is_complete:
        return WITH_LOSS
    return INTERRUPTED if flag.interrupted else OK


def _settings(args: argparse.Namespace) -> Settings:
    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.device import Settings
    from ertis_driver.errors import SettingsError
    from ertis_driver.frame import DEFAULT_NUM_WORDS

    if args.pings is not None and not 1 <= args.pings <= MAX_PINGS:
        raise SettingsError(f"--pings {args.pings}, expected 1 to {MAX_PINGS}")
    if not 0 <= args.rate <= 100:
        raise SettingsError(f"--rate {args.rate:g}, expected 0 to 100 pings a second")
    check_air(args.temperature_c, args.humidity_percent)
    check_output(args.output)
    chirp = Chirp.parse(args.chirp) if args.chirp else DEFAULT_CHIRP
    return Settings(chirp, DEFAULT_NUM_WORDS if args.words is None else args.words)


def _info(args: argparse.Namespace, sonar: Sonar, settings: Settings) -> RecordingInfo:
    from datetime import datetime

    from ertis_driver.recording import RecordingInfo

    return RecordingInfo(
        source=sonar.info.source,
        chirp=settings.chirp,
        num_words=settings.num_words,
        temperature_c=args.temperature_c,
        humidity_percent=args.humidity_percent,
        firmware=sonar.info.firmware,
        address=sonar.info.address,
        pdm_rate_hz=settings.pdm_rate_hz,
        operator=args.who,
        place=args.where,
        note=args.note,
        licence=args.licence,
        started=datetime.now().astimezone().isoformat(timespec="seconds"),
        emissions=settings.emissions,
        amplifier={None: "", True: "on", False: "off"}[settings.amplifier],
    )


def _writer(args: argparse.Namespace, info: RecordingInfo) -> RecordingWriter | SplitRecording:
    from ertis_driver.recording import RecordingWriter
    from ertis_driver.split_recording import SplitRecording

    options = {"compress": args.compress, "sync_period_s": args.sync}
    output = args.output if args.output.suffix else args.output.with_suffix(".mcap")
    if args.split:
        return SplitRecording(output, info, args.split, **options)
    return RecordingWriter(output, info, **options)


class _LiveLine:
    """What a terminal shows meanwhile; nothing elsewhere."""

    def __init__(self, writer: RecordingWriter | SplitRecording) -> None:
        self._writer = writer
        self._due_s = 0.0
        self._is_shown = False

    def show(self, report: SessionReport) -> None:
        if report.seconds < self._due_s or not sys.stderr.isatty():
            return
        self._due_s = report.seconds + _PROGRESS_PERIOD_S
        self._is_shown = True
        text = f"{report.seconds:.0f} s  {report.pings} pings"
        if report.seconds > 1:
            text += f"  {report.pings / report.seconds:.1f}/s"
        text += f"  {size_text(self._writer.size)}  lost {report.pings_lost + report.pings_failed}"
        print(f"\r{text}  {report.look or ''}\x1b[K", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        if self._is_shown:
            print(file=sys.stderr)


def _close(writer: RecordingWriter | SplitRecording, report: SessionReport) -> None:
    """Close the file; on a full disk it may stay without an end, which recover can make."""
    from ertis_driver.errors import DiskFull

    try:
        writer.close()
    except DiskFull as error:
        report.disk_full(error)


def _tell(args: argparse.Namespace, writer: Any, report: SessionReport, looker: Any) -> None:
    from ertis_daemon.recordings.looking import name_faulty

    paths = [str(path) for path in getattr(writer, "paths", [getattr(writer, "path", "")])]
    often = sorted(fault for fault, count in looker.faults.items() if 2 * count > looker.looked)
    if args.json:
        told = {
            "files": paths,
            "pings": report.pings,
            "pings_lost": report.pings_lost,
            "pings_failed": report.pings_failed,
            "bytes": writer.size,
            "seconds": round(report.seconds, 3),
            "ended": report.ended,
            "error": report.error,
            "faulty_microphones": [{"row": row, "state": state} for row, state in often],
        }
        print(json.dumps(told))
    if report.error:
        print(f"ertis: {report.error}", file=sys.stderr)
    if often:
        print(f"ertis: {name_faulty(often)}", file=sys.stderr)
    lost = report.pings_lost + report.pings_failed
    print(
        f"ertis: {report.pings} pings in {report.seconds:.1f} s, {lost} lost, "
        f"{size_text(writer.size)}: {', '.join(paths)} ({report.ended})",
        file=sys.stderr,
    )
