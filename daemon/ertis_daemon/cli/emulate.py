"""``ertis emulate``: be an eRTIS on a pseudo-terminal."""

from __future__ import annotations

import argparse
import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from ertis_daemon.cli.signals import stop_on_signals

if TYPE_CHECKING:
    from ertis_driver.emulator import Emulator
    from ertis_driver.fault_plan import FaultPlan, PlannedFault
    from ertis_driver.firmware import FrameSource
    from ertis_driver.frame import Source

PINS = {signal.SIGUSR1: 1, signal.SIGUSR2: 2}

EPILOG = """\
The port's path is the first line on stdout, and another line each time that the device is back
after an unplug. SIGUSR1 is an edge on external trigger pin 1, SIGUSR2 on pin 2.

faults: KIND@frame=N,key=value,... (or reply=N; N counts from 0), where byte is a place in the
message, negative from its end:
  drop,double      byte count          bytes are lost, come twice
  insert           byte count seed     random bytes come in between
  flip             byte mask           bits of one byte change
  magic            footer word         the header or footer is another word
  truncate         byte                it ends early, one more frame follows at once
  stall            byte seconds        a pause; then it goes on
  silent           byte ever           nothing more until the next command, or ever
  late             past_replies        it comes with the next reply, or with the next frame
  babble           byte seconds seed   rubbish instead of the rest
  jump             by                  the ping counter jumps after it
  reset            byte                reboots: counter and settings are lost
  vanish           byte away           unplugged; back after so many seconds, if given
for example --fault drop@frame=3,byte=1000,count=7 --fault vanish@frame=9,byte=500,away=2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--replay", type=Path, metavar="FILE", help="pings of a recording")
    what.add_argument("--scene", type=Path, metavar="SCENE.yaml", help="pings in a simulated scene")
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="FILE.jsonl",
        help="write where each landmark really is, with --scene",
    )
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="a symbolic link to keep pointed at the port"
    )
    parser.add_argument(
        "--trigger-form",
        choices=("linux", "windows"),
        default="linux",
        help="what A means: 1 is active for the incumbent's Linux client, 0 for the Windows one",
    )
    parser.add_argument("--json", action="store_true", help="print the port as a JSON object")
    parser.add_argument("--no-amplifier", action="store_true", help="decline K, as some boards do")
    parser.add_argument("--no-trigger", action="store_true", help="decline J, as some boards do")
    parser.add_argument(
        "--fault", type=_fault, action="append", default=[], help="what shall go wrong, see below"
    )
    parser.add_argument(
        "--fault-rate", type=float, metavar="SHARE", help="which share of the frames is hit"
    )
    parser.add_argument("--fault-seed", type=int, metavar="N", help="of --fault-rate, default 0")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def run(args: argparse.Namespace) -> int:
    """Serve until stopped by a signal, or until unplugged for ever."""
    from ertis_driver.emulator import Emulator
    from ertis_driver.errors import SettingsError

    if args.truth and not args.scene:
        raise SettingsError("--truth is for --scene: nobody knows the truth of a recording")
    faults = _faults(args)
    source, mark = _source(args)
    say = _say_json if args.json else _say
    declined = {"K": args.no_amplifier, "J": args.no_trigger}
    with stop_on_signals() as flag:
        emulator = Emulator(
            source,
            mark=mark,
            trigger_form=args.trigger_form,
            unsupported=[letter for letter, off in declined.items() if off],
            faults=faults,
            link=args.link,
            on_plug=say,
        )
        try:
            with _edges_on_signals(emulator):
                say(emulator.path)
                emulator.serve(flag.event)
        finally:
            emulator.close()
    return 130 if flag.interrupted else 0


def _say(path: str) -> None:
    print(path, flush=True)


def _say_json(path: str) -> None:
    print(json.dumps({"port": path}), flush=True)


@contextmanager
def _edges_on_signals(emulator: Emulator) -> Iterator[None]:
    def edge(number: int, frame: FrameType | None) -> None:
        emulator.trigger(PINS[signal.Signals(number)])

    before = {number: signal.signal(number, edge) for number in PINS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _fault(text: str) -> PlannedFault:
    from ertis_driver.errors import SettingsError
    from ertis_driver.fault_plan import parse_fault

    try:
        return parse_fault(text)
    except SettingsError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def _faults(args: argparse.Namespace) -> FaultPlan | None:
    from ertis_driver.errors import SettingsError
    from ertis_driver.fault_plan import DrawnFaults, NamedFaults

    if args.fault_rate is None:
        if args.fault_seed is not None:
            raise SettingsError("--fault-seed draws nothing without --fault-rate: give both")
        return NamedFaults(args.fault) if args.fault else None
    if args.fault:
        raise SettingsError("--fault and --fault-rate exclude each other: give one of them")
    return DrawnFaults(args.fault_seed or 0, args.fault_rate)


def _source(args: argparse.Namespace) -> tuple[FrameSource, Source]:
    if args.scene:
        from ertis_simulator.device import scene_frame_source

        return scene_frame_source(args.scene, args.truth), "sim"
    from ertis_driver.replay_source import ReplaySource

    source = ReplaySource(args.replay)
    return source, source.mark
