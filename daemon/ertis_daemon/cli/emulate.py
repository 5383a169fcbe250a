"""``ertis emulate``: be an eRTIS on a pseudo-terminal."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.cli.signals import stop_on_signals

if TYPE_CHECKING:
    from ertis_driver.firmware import FrameSource
    from ertis_driver.frame import Source


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
    parser.epilog = "The port's path is the first line on stdout."


def run(args: argparse.Namespace) -> int:
    """Serve until stopped by a signal."""
    from ertis_driver.emulator import Emulator
    from ertis_driver.errors import SettingsError

    if args.truth and not args.scene:
        raise SettingsError("--truth is for --scene: nobody knows the truth of a recording")
    source, mark = _source(args)
    with stop_on_signals() as flag:
        emulator = Emulator(source, mark=mark)
        try:
            print(emulator.path, flush=True)
            emulator.serve(flag.event)
        finally:
            emulator.close()
    return 130 if flag.interrupted else 0


def _source(args: argparse.Namespace) -> tuple[FrameSource, Source]:
    if args.scene:
        from ertis_simulator.device import scene_frame_source

        return scene_frame_source(args.scene, args.truth), "sim"
    from ertis_driver.replay_source import ReplaySource

    source = ReplaySource(args.replay)
    return source, source.mark
