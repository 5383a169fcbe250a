"""``ertis monitor``: print landmark events as they are published."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from ertis_daemon.cli.signals import stop_on_signals

POLL_S = 0.02  # a blocking recv would not see a signal
EVENTS_WAITING = 1024  # half a minute at 30 a second; then the oldest is dropped
HISTORY = 32  # what the daemon keeps


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
    parser.add_argument("--device", default="*", metavar="NAME", help="one sonar only")
    parser.add_argument("--json", action="store_true", help="print events as they came, JSON Lines")
    parser.add_argument("--log", type=Path, metavar="FILE", help="also append events as JSON Lines")
    parser.add_argument("--count", type=int, default=0, metavar="N", help="end after N events")


def run(args: argparse.Namespace) -> int:
    """Print until stopped by a signal or ``--count``."""
    import zenoh
    from zenoh import ext

    from ertis_daemon.publisher import close_session, open_session, session_config

    connect = args.connect or ["tcp/localhost:7447"]
    with ExitStack() as stack:
        flag = stack.enter_context(stop_on_signals())
        log = stack.enter_context(_open_log(args.log)) if args.log else None
        session = open_session(session_config(args.mode, connect, ["tcp/localhost:0"]))
        stack.callback(close_session, session)
        subscriber = _declare(session, zenoh, ext, f"ertis/{args.device}/landmarks")
        seen = 0
        while not flag.event.is_set() and (seen < args.count or not args.count):
            sample = subscriber.try_recv()
            if sample is None:
                time.sleep(POLL_S)
                continue
            seen += 1
            payload = sample.payload.to_bytes()
            if log:
                log.write(payload + b"\n")
                log.flush()
            _show(payload, str(sample.key_expr), raw=args.json)
    return 130 if flag.interrupted else 0


def _open_log(path: Path) -> Any:
    from ertis_daemon.publisher import PublisherError

    try:
        return path.open("ab")
    except OSError as error:
        raise PublisherError(f"{path}: {error.strerror or error}") from error


def _declare(session: Any, zenoh: Any, ext: Any, key: str) -> Any:
    from ertis_daemon.publisher import PublisherError

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


def _show(payload: bytes, key: str, *, raw: bool) -> None:
    if raw:
        print(payload.decode(errors="replace"), flush=True)
        return
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
        f"{stamp}  {event['device']}  {_landmark(item)}  {event['source']}"
        for item in event["landmarks"]
    ]


def _landmark(item: Mapping[str, Any]) -> str:
    label = item["class"]
    percent = _number(item["probabilities"].get(label), 100, "3.0f")
    bearing = " ".join(
        _number(item[key], 180 / math.pi, "+6.1f") for key in ("azimuth_rad", "elevation_rad")
    )
    return (
        f"{label:>7} {percent} %  {_number(item['range_m'], 1, '6.3f')} m  {bearing} deg  "
        f"track {item['track_id']} {item['state']:<6}"
    )


def _number(value: float | None, factor: float, form: str) -> str:
    return "?" if value is None else format(value * factor, form)
