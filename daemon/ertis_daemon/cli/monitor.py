"""``ertis monitor``: what the daemons publish, as a live table or line by line."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ertis_daemon.cli.signals import StopFlag, stop_on_signals

POLL_S = 0.02  # a blocking recv would not see a signal
EVENTS_WAITING = 1024  # half a minute at 30 a second; then the oldest is dropped
HISTORY = 32  # what the daemon keeps
ALONE_S = 3.0  # with nobody to hear from, before that is said
HINT = "--connect wants a Zenoh router, or what the daemon listens on (zenoh.listen)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "--connect",
        action="append",
        metavar="LOCATOR",
        help="daemon or router, default tcp/localhost:7447; may be repeated",
    )
    parser.add_argument(
        "--mode", choices=("peer", "client"), default="peer", help="client for a distant router"
    )
    parser.add_argument(
        "--tls", default="", metavar="DIR", help="ca.pem, cert.pem, key.pem for a secured router"
    )
    parser.add_argument("--device", default="*", metavar="NAME", help="one sonar only")
    parser.add_argument("--json", action="store_true", help="print events as they came, JSON Lines")
    parser.add_argument("--status", action="store_true", help="with --json: print status instead")
    parser.add_argument(
        "--lines", action="store_true", help="a line a landmark, on a terminal as well"
    )
    parser.add_argument("--log", type=Path, metavar="FILE", help="also append events as JSON Lines")
    parser.add_argument("--count", type=int, default=0, metavar="N", help="end after N events")


def run(args: argparse.Namespace) -> int:
    """Print until stopped by a signal or ``--count``."""
    from ertis_daemon.cli.monitor_table import LiveTable
    from ertis_daemon.zenoh_session import close_session, open_session, session_config
    from ertis_driver.errors import SettingsError

    if args.count < 0:
        raise SettingsError(f"--count {args.count}, expected 0 or more")
    if args.device != "*":
        _check_name(args.device)
    connect = args.connect or ["tcp/localhost:7447"]
    with ExitStack() as stack:
        flag = stack.enter_context(stop_on_signals())
        log = stack.enter_context(_open_log(args.log)) if args.log else None
        session = open_session(session_config(args.mode, connect, ["tcp/localhost:0"], args.tls))
        stack.callback(close_session, session)
        topic = "status" if args.json and args.status else "landmarks"
        events = _declare(session, f"ertis/{args.device}/{topic}")
        if args.json or args.lines or not sys.stdout.isatty():
            show = _print_raw if args.json else _print_lines
            return _follow(events, show, log, args.count, flag, _hint(session, connect))
        statuses = _declare(session, f"ertis/{args.device}/status")
        table = stack.enter_context(LiveTable(statuses.try_recv, ", ".join(connect)))
        return _follow(events, table.show, log, args.count, flag, table.refresh)


def _check_name(name: str) -> None:
    from ertis_daemon.config import check_chunk
    from ertis_driver.errors import SettingsError

    if check_chunk(name):
        raise SettingsError(f"--device {name!r}, expected one sonar's name: leave it out for all")


def _hint(session: Any, connect: list[str]) -> Callable[[], None]:
    """Say once, after a while, that nobody is there to hear from."""
    due_s = time.monotonic() + ALONE_S

    def hint() -> None:
        nonlocal due_s
        if time.monotonic() < due_s:
            return
        due_s = math.inf
        if not (session.info.routers_zid() or session.info.peers_zid()):
            print(f"ertis: nobody at {', '.join(connect)} yet; {HINT}", file=sys.stderr)

    return hint


def _follow(
    events: Any,
    show: Callable[[bytes, str], None],
    log: Any,
    count: int,
    flag: StopFlag,
    idle: Callable[[], None],
) -> int:
    seen = 0
    while not flag.event.is_set() and (seen < count or not count):
        idle()
        sample = events.try_recv()
        if sample is None:
            time.sleep(POLL_S)
            continue
        seen += 1
        payload = sample.payload.to_bytes()
        if log:
            log.write(payload + b"\n")
            log.flush()
        show(payload, str(sample.key_expr))
    return 130 if flag.interrupted else 0


def _open_log(path: Path) -> Any:
    from ertis_daemon.zenoh_session import PublisherError

    try:
        return path.open("ab")
    except OSError as error:
        raise PublisherError(f"{path}: {error.strerror or error}") from error


def _declare(session: Any, key: str) -> Any:
    import zenoh
    from zenoh import ext

    from ertis_daemon.zenoh_session import PublisherError

    try:
        return ext.declare_advanced_subscriber(
            session,
            key,
            zenoh.handlers.RingChannel(EVENTS_WAITING),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=HISTORY),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
    except zenoh.ZError as error:
        raise PublisherError(f"Zenoh refuses the key {key!r}") from error


def _print_raw(payload: bytes, key: str) -> None:
    print(payload.decode(errors="replace"), flush=True)


def _print_lines(payload: bytes, key: str) -> None:
    try:
        lines = format_event(json.loads(payload))
    except (ValueError, KeyError, TypeError) as error:
        print(f"ertis: {key}: not one of our events: {error!r}", file=sys.stderr)
        return
    for line in lines:
        print(line, flush=True)


def format_event(event: Mapping[str, Any]) -> list[str]:
    """One line for each landmark: time, class, probability, range, bearing, source, track.

    Raises
    ------
    KeyError, TypeError
        If it is no landmark event.
    """
    seconds, rest_ns = divmod(event["ping_time_ns"], 1_000_000_000)
    clock = time.strftime("%H:%M:%S", time.localtime(seconds))
    stamp = f"{clock}.{rest_ns // 1_000_000:03d}"
    return [
        f"{stamp}  {event['device']}  {format_landmark(item)}  {event['source']}"
        for item in event["landmarks"]
    ]


def format_landmark(item: Mapping[str, Any]) -> str:
    """Class, probability, range, bearing and track of one landmark; ``?`` for null.

    Raises
    ------
    KeyError, TypeError
        If it is none.
    """
    label = item["class"]
    percent = number(item["probabilities"].get(label), 100, "3.0f")
    bearing = " ".join(
        number(item[key], 180 / math.pi, "+6.1f") for key in ("azimuth_rad", "elevation_rad")
    )
    return (
        f"{label:>7} {percent} %  {number(item['range_m'], 1, '6.3f')} m  {bearing} deg  "
        f"track {item['track_id']} {item['state']:<6}"
    )


def number(value: float | None, factor: float, form: str) -> str:
    """A number times a factor; ``?`` for None."""
    return "?" if value is None else format(value * factor, form)
