"""``ertis detect``: the daemon's own path on a recording, each ping for itself and as tracks."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ertis_daemon.config import Config
    from ertis_detector.detection import Detection
    from ertis_detector.detector import Scanner
    from ertis_driver.chirp import Emission
    from ertis_driver.recording import RecordedPing, Recording

_SAID = {"sim": "simulated", "replay": "recorded"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("file", type=Path, help="MCAP recording, or headerless uint32 PDM words")
    parser.add_argument("--json", action="store_true", help="one JSON object a ping")
    parser.add_argument("--plot", type=Path, metavar="OUT.png", help="draw the first ping")
    parser.add_argument(
        "--reflectors", type=int, default=0, metavar="N", help="name the N strongest echoes too"
    )
    parser.add_argument("--model", metavar="FILE", help="default: the one shipped for the chirp")
    parser.add_argument(
        "--min-probability", type=float, default=0.0, metavar="P", help="0: the model's own"
    )
    parser.add_argument(
        "--chirp",
        metavar="KIND:START:STOP:SECONDS",
        help="of a file that does not say; default: heard from the direct path",
    )
    parser.add_argument(
        "--temperature-c", type=float, metavar="T", help="air; default: as recorded, or 20"
    )


def run(args: argparse.Namespace) -> int:
    """Detect in every ping and print what was found."""
    from ertis_daemon.event_of import report
    from ertis_daemon.events import dump_json
    from ertis_daemon.pipeline import build_pipeline, build_scanner
    from ertis_driver.device import Settings
    from ertis_driver.recording import open_recording

    recording = open_recording(args.file)
    chirp = _chirp(args, recording)
    config = _config(args, recording)
    settings = Settings(chirp, recording.info.num_words)
    pipeline = build_pipeline(config, settings)
    scanner = build_scanner(settings, config.speed_of_sound_m_s)
    source = "sim" if recording.info.source == "sim" else "replay"
    for number, ping in enumerate(recording):
        heard = pipeline.process(ping.frame)
        line: dict[str, Any] = {
            "ping_index": ping.frame.ping_index,
            "source": source,
            "model": pipeline.model_name,
            "chirp": chirp.name,
            "landmarks": [_plain(one) for one in heard.detections],
            "tracks": [json.loads(dump_json(report(track))) for track in heard.tracks],
        }
        picture = args.plot if number == 0 else None
        if args.reflectors or picture:
            title = f"{args.file.name}, ping {ping.frame.ping_index} ({_SAID[source]})"
            line["reflectors"] = _look(ping, scanner, args.reflectors, line, picture, title)
        print(json.dumps(line) if args.json else _text(line))
    return 0


def _plain(one: Detection) -> dict[str, Any]:
    """What one ping tells of one landmark, as events name it."""
    import dataclasses

    from ertis_daemon.events import dump_json

    fields = dataclasses.asdict(one)
    told = {"class": fields.pop("label"), **fields, "radius_m": one.radius_m}
    plain: dict[str, Any] = json.loads(dump_json(told))
    return plain


def _look(
    ping: RecordedPing,
    scanner: Scanner,
    count: int,
    line: dict[str, Any],
    picture: Path | None,
    title: str,
) -> list[dict[str, float]]:
    """The strongest reflectors; draws the picture if one is wanted."""
    import dataclasses

    from ertis_detector.reflectors import strongest
    from ertis_driver.audio import PdmDecoder, whole_samples

    decoded = PdmDecoder().decode(whole_samples(ping.frame.words))
    baseband, scape = scanner.image(decoded.audio)
    spots = strongest(scanner, baseband, scape, count) if count else []
    if picture is not None:
        from ertis_daemon.picture import draw

        named = [
            (f"{one['class']} {one['probabilities'][one['class']]:.2f}", one)
            for one in line["landmarks"]
        ]
        places = [(text, one["range_m"], one["azimuth_rad"]) for text, one in named]
        draw(scape, places, spots, title, picture)
    return [dataclasses.asdict(spot) for spot in spots]


def _chirp(args: argparse.Namespace, recording: Recording) -> Emission:
    from ertis_daemon.chirp_guess import guess_chirp
    from ertis_driver.audio import PdmDecoder, whole_samples
    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.errors import RecordingError

    if recording.info.chirp is not None:
        if args.chirp and Chirp.parse(args.chirp) != recording.info.chirp:
            raise RecordingError(
                f"{args.file} was recorded with chirp {recording.info.chirp.name}, "
                f"met --chirp {args.chirp}: leave it out"
            )
        return recording.info.chirp
    if args.chirp:
        return Chirp.parse(args.chirp)
    for ping in recording:
        heard = PdmDecoder().decode(whole_samples(ping.frame.words)).audio
        chirp = guess_chirp(heard)
        if chirp is None:
            print(
                f"ertis: {args.file} says no chirp and none is heard in its direct path: taken for "
                f"{DEFAULT_CHIRP.name}; --chirp names another",
                file=sys.stderr,
            )
            return DEFAULT_CHIRP
        print(
            f"ertis: {args.file} says no chirp; its direct path sounds like {chirp.name}; "
            "--chirp names another",
            file=sys.stderr,
        )
        return chirp
    raise RecordingError(f"{args.file} holds no ping")


def _config(args: argparse.Namespace, recording: Recording) -> Config:
    import dataclasses

    from ertis_daemon.config import Config, example_yaml
    from ertis_daemon.config_read import parse_config

    config = Config()
    recorded = recording.info.temperature_c
    temperature_c = args.temperature_c
    if temperature_c is None:
        temperature_c = config.temperature_c if recorded is None else recorded
    detector = dataclasses.replace(
        config.detector, model=args.model or "", min_probability=args.min_probability
    )
    config = dataclasses.replace(config, temperature_c=temperature_c, detector=detector)
    # Checked as if it stood in a configuration file.
    return parse_config(example_yaml(config).encode(), "flags")


def _text(line: dict[str, Any]) -> str:
    import math

    found = [
        f"{one['class']} ({one['probabilities'][one['class']]:.2f}) at {one['range_m']:.3f} m, "
        f"{math.degrees(one['azimuth_rad']):+.1f} deg"
        for one in line["landmarks"]
    ]
    text = f"ping {line['ping_index']} [{line['source']}]: {'; '.join(found) or 'no landmark'}"
    for one in line["tracks"]:
        if one["state"] != "update":
            text += f"\n  track {one['track_id']} {one['state']}: {one['class']}"
    for spot in line.get("reflectors", []):
        text += (
            f"\n  reflector {spot['range_m']:.3f} m, {math.degrees(spot['azimuth_rad']):+.1f} deg, "
            f"{math.degrees(spot['elevation_rad']):+.1f} deg up, {spot['level_db']:.1f} dB"
        )
    return text
