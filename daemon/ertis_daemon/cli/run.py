"""``ertis run``: the daemon."""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.cli.signals import stop_on_signals

if TYPE_CHECKING:
    from ertis_daemon.status import Status


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags; everything else is in the configuration."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="YAML, see check-config; laid over /etc/ertis/ertis.yaml and the user's own",
    )
    parser.add_argument("--address", metavar="A", help="sonar, instead of the configured one")
    parser.add_argument("--device", metavar="NAME", help="name in the Zenoh keys, likewise")
    parser.add_argument("--max-pings", metavar="N", help="end after N pings heard")
    parser.add_argument("--json", action="store_true", help="print the final counters as JSON")
    parser.add_argument("-v", "--verbose", action="store_true", help="log every event")


def run(args: argparse.Namespace) -> int:
    """Serve until stopped by a signal, the end of recordings or ``--max-pings``."""
    # All that takes time to import, before signals are handled: until then, one ends it at once.
    import ertis_detector.detector
    import ertis_detector.model
    import ertis_detector.tracker  # noqa: F401
    from ertis_daemon.layers import Sources
    from ertis_daemon.memory import keep_freed_memory
    from ertis_daemon.serving.daemon import Daemon
    from ertis_daemon.serving.journal import log_to_stderr

    log_to_stderr(verbose=args.verbose)
    keep_freed_memory()
    sources = Sources(args.config, _flags(args))
    config = sources.load()
    stop = threading.Event()
    daemon = Daemon(config, stop, sources)
    hang_up = None if sys.stderr.isatty() else daemon.hang_up
    with stop_on_signals(stop, hang_up=hang_up) as flag:
        statuses = daemon.run()
    _tell(statuses, as_json=args.json)
    return 130 if flag.interrupted else 0


def _flags(args: argparse.Namespace) -> dict[str, str]:
    """The flags as configuration keys."""
    given = {
        "device.address": args.address,
        "device.name": args.device,
        "max_pings": args.max_pings,
    }
    return {key: text for key, text in given.items() if text is not None}


def _tell(statuses: Mapping[str, Status], *, as_json: bool) -> None:
    from ertis_daemon.events import dump_json

    for name, status in statuses.items():
        if as_json:
            print(dump_json(status.to_json()).decode())
        else:
            print(
                f"ertis: {name}: heard {status.pings_heard} pings, {status.events} events, "
                f"{status.queue_drops} dropped, {status.pings_lost} lost",
                file=sys.stderr,
            )
