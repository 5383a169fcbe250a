"""``ertis info``: what a recording holds."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.quantities import size_text

if TYPE_CHECKING:
    from ertis_driver.inspect_recording import Contents

OK, WITH_FINDINGS = 0, 3

EPILOG = """\
A recording that was closed tells at once; --check reads all of it and compares every checksum. One
without an end is always read.

for example
  ertis info hall.mcap --check

Exit code: 0 it is whole, as far as was looked; 3 it is cut off or damaged.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("file", type=Path, help="MCAP recording, or headerless uint32 PDM words")
    parser.add_argument("--check", action="store_true", help="read all of it")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter


def run(args: argparse.Namespace) -> int:
    """Say what is in it."""
    from ertis_driver.inspect_recording import inspect

    contents = inspect(args.file, check=args.check)
    if args.json:
        print(json.dumps(_object(args.file, contents)))
    else:
        print("\n".join(f"{name:<12} {text}" for name, text in _rows(args.file, contents) if text))
    return OK if contents.damage is None else WITH_FINDINGS


def _object(path: Path, contents: Contents) -> dict[str, Any]:
    info, damage = contents.info, contents.damage
    return {
        "file": str(path),
        "bytes": contents.num_bytes,
        "source": info.source,
        "pings": contents.num_pings,
        "pings_lost": contents.pings_lost,
        "messages": contents.num_messages,
        "start_ns": contents.start_ns,
        "end_ns": contents.end_ns,
        "duration_s": contents.duration_s,
        "chirp": info.chirp.name if info.chirp else None,
        "num_words": info.num_words,
        "pdm_rate_hz": info.pdm_rate_hz,
        "emissions": info.emissions,
        "amplifier": info.amplifier,
        "compressed": contents.is_compressed,
        "temperature_c": info.temperature_c,
        "humidity_percent": info.humidity_percent,
        "firmware": info.firmware,
        "device": info.address,
        "operator": info.operator,
        "place": info.place,
        "note": info.note,
        "licence": info.licence,
        "started": info.started,
        "part": info.part,
        "mic_positions_m": info.mic_positions_m,
        "closed": contents.has_end,
        "checked": contents.checked,
        "damage": None
        if damage is None
        else {"offset": damage.offset, "pings_before": damage.num_pings, "cut": damage.is_cut}
        | {"message": str(damage)},
    }


def _rows(path: Path, contents: Contents) -> list[tuple[str, str]]:
    info = contents.info
    part = f", part {info.part}" if info.part else ""
    chirp = info.chirp.name if info.chirp else "not told"
    temperature = "" if info.temperature_c is None else f"{info.temperature_c:g} degrees Celsius"
    humidity = "" if info.humidity_percent is None else f"{info.humidity_percent:g} %"
    return [
        ("file", f"{path}, {size_text(contents.num_bytes)}{part}"),
        ("source", {"sim": "sim: simulated, not heard"}.get(info.source, info.source)),
        ("pings", _pings(contents)),
        ("time", _time(contents)),
        ("frames", _frames(contents)),
        ("chirp", f"{chirp}, {info.emissions} a ping" if info.emissions > 1 else chirp),
        ("device", " ".join(filter(None, [info.address, info.firmware and f"({info.firmware})"]))),
        ("amplifier", info.amplifier),
        ("temperature", temperature),
        ("humidity", humidity),
        ("who", info.operator),
        ("where", info.place),
        ("note", info.note),
        ("licence", info.licence),
        ("also holds", _others(contents)),
        ("state", _state(contents)),
    ]


def _pings(contents: Contents) -> str:
    lost = contents.pings_lost
    text = str(contents.num_pings)
    if lost:
        text += f", {lost} lost between them"
    duration_s = contents.duration_s
    if duration_s and contents.num_pings > 1:
        text += f"; {(contents.num_pings - 1) / duration_s:.2f} a second"
    return text


def _time(contents: Contents) -> str:
    from datetime import datetime, timezone

    if contents.start_ns is None or contents.duration_s is None:
        return "not told"
    try:
        start = datetime.fromtimestamp(contents.start_ns / 1e9, timezone.utc)
    except (OverflowError, ValueError, OSError):
        return f"{contents.start_ns} ns, {contents.duration_s:.1f} s"
    return f"{start:%Y-%m-%d %H:%M:%S} UTC, {contents.duration_s:.1f} s"


def _frames(contents: Contents) -> str:
    info = contents.info
    milliseconds = info.num_words / info.pdm_rate_hz * 1e3
    packed = ", compressed" if contents.is_compressed else ""
    return (
        f"{info.num_words} words ({milliseconds:.1f} ms at {info.pdm_rate_hz / 1e6:g} MHz){packed}"
    )


def _others(contents: Contents) -> str:
    own = ("pdm", "ping", "microphones", "tf", "detections", "truth/points")
    names = {"truth": "truth", "events": "events", "picture": "pictures", "log": "lines of log"}
    return ", ".join(
        f"{count} {names.get(topic, topic)}"
        for topic, count in contents.num_messages.items()
        if topic not in own
    )


def _state(contents: Contents) -> str:
    if contents.damage is not None:
        return str(contents.damage)
    return "whole: every checksum is right" if contents.checked else "closed; --check reads it all"
