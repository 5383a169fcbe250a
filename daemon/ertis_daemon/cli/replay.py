"""``ertis replay``: a recording as if it were heard now."""

from __future__ import annotations

import argparse
from pathlib import Path

from ertis_daemon.cli.signals import stop_on_signals

EPILOG = """\
zenoh: the daemon's own path, events and all, marked source replay (sim, if a simulation was
recorded). The same recording gives the same events, byte for byte, every time.
pty: an emulated sonar that hears the recording. Its port is the first line on stdout; it ends when
it is asked for a ping after the last.

for example
  ertis replay hall.mcap --rate 2 --loop
  ertis replay hall.mcap --to pty
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("file", type=Path, help="MCAP recording, or headerless uint32 PDM words")
    parser.add_argument("--to", choices=("zenoh", "pty"), default="zenoh", help="default zenoh")
    parser.add_argument(
        "--rate",
        type=float,
        default=1.0,
        metavar="R",
        help="1 keeps the recorded pace (default), 2 halves the times, 0 waits for nothing",
    )
    parser.add_argument("--loop", action="store_true", help="begin again after the last ping")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="the daemon's, with --to zenoh; see check-config",
    )
    parser.add_argument("--device", metavar="NAME", help="name in the Zenoh keys, likewise")
    parser.add_argument(
        "--link", type=Path, metavar="PATH", help="a symbolic link to the port, with --to pty"
    )
    parser.add_argument("--json", action="store_true", help="print the final counters as JSON")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def run(args: argparse.Namespace) -> int:
    """Play to the end, or until stopped."""
    from ertis_driver.errors import SettingsError

    if args.to == "pty":
        if args.config or args.device or args.json:
            raise SettingsError("--config, --device and --json are for --to zenoh: leave them out")
        return _to_pty(args)
    if args.link:
        raise SettingsError("--link is for --to pty: leave it out")
    return _to_zenoh(args)


def _to_zenoh(args: argparse.Namespace) -> int:
    """What ``ertis run`` does at the recording's address."""
    from ertis_daemon.cli import run as daemon

    options = [f"rate={args.rate!r}"] * bool(args.rate) + ["loop=1"] * args.loop
    address = f"replay:{args.file}" + ("?" + "&".join(options) if options else "")
    argv = ["--address", address]
    argv += ["--config", str(args.config)] if args.config else []
    argv += ["--device", args.device] if args.device else []
    argv += ["--json"] if args.json else []
    parser = argparse.ArgumentParser()
    daemon.add_arguments(parser)
    return daemon.run(parser.parse_args(argv))


def _to_pty(args: argparse.Namespace) -> int:
    from ertis_driver.emulator import Emulator
    from ertis_driver.replay_source import ReplaySource

    with stop_on_signals() as flag:
        source = ReplaySource(args.file, rate=args.rate or None, loop=args.loop, stop=flag.event)
        firmware = source.recording.info.firmware or "2.3.4"
        emulator = Emulator(
            source, mark=source.mark, firmware=firmware, link=args.link, on_plug=_say
        )
        try:
            _say(emulator.path)
            emulator.serve(flag.event)
        finally:
            emulator.close()
    return 130 if flag.interrupted else 0


def _say(path: str) -> None:
    print(path, flush=True)
