"""``ertis detect``: the daemon's own detector on a recording, every ping by itself."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.before_work import check_air, check_output

if TYPE_CHECKING:
    from ertis_detector.air import Air
    from ertis_detector.detector import LandmarkDetector, Scan
    from ertis_detector.reflectors import Reflector
    from ertis_detector.scanner import Scanner
    from ertis_driver.chirp import Emission
    from ertis_driver.device import Settings
    from ertis_driver.recording import RecordedPing, Recording

_SAID = {"sim": "simulated", "replay": "recorded"}
_MAX_DETECTORS = 16


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
    parser.add_argument(
        "--humidity-percent", type=float, metavar="H", help="the same; default: as recorded, or 50"
    )


def run(args: argparse.Namespace) -> int:
    """Detect in every ping by itself and print what was found."""
    from ertis_driver.device import Settings
    from ertis_driver.errors import SettingsError
    from ertis_driver.recording import open_recording

    if not 0 <= args.min_probability <= 1:
        raise SettingsError(f"--min-probability {args.min_probability:g}, expected 0 to 1")
    check_air(args.temperature_c, args.humidity_percent)
    if args.reflectors < 0:
        raise SettingsError(f"--reflectors {args.reflectors}, expected 0 or more")
    if args.plot is not None:
        check_output(args.plot)
    recording = open_recording(args.file)
    chirp = _chirp(args, recording)
    look = _Look(args, Settings(chirp, recording.info.num_words), recording)
    for number, ping in enumerate(recording):
        line = look.at(ping, args.plot if number == 0 else None)
        print(json.dumps(line) if args.json else _text(line))
    return 0


class _Look:
    """One detector for each air, and what it says of a ping."""

    def __init__(self, args: argparse.Namespace, settings: Settings, recording: Recording) -> None:
        from ertis_driver.audio import PdmDecoder

        self._args, self._settings, self._info = args, settings, recording.info
        self._decoder = PdmDecoder()
        self._detectors: dict[Air, LandmarkDetector] = {}
        self._source = "sim" if recording.info.source == "sim" else "replay"
        self._detector(self._air(None, None))  # a wrong model is told before the first ping

    def at(self, ping: RecordedPing, picture: Path | None) -> dict[str, Any]:
        """One line of output; draws the picture if one is wanted."""
        from ertis_daemon.event_of import report
        from ertis_daemon.events import dump_json
        from ertis_detector.tracker import Track
        from ertis_driver.audio import whole_samples

        detector = self._detector(self._air(ping.temperature_c, ping.humidity_percent))
        scan = detector.scan(self._decoder.decode(whole_samples(ping.frame.words)).audio)
        found = [Track(n, "new", one) for n, one in enumerate(detector.judge(scan), 1)]
        line: dict[str, Any] = {
            "ping_index": ping.frame.ping_index,
            "source": self._source,
            "model": detector.model.name,
            "chirp": self._settings.chirp.name,
            "landmarks": [json.loads(dump_json(report(track))) for track in found],
        }
        count = self._args.reflectors
        if count or picture:
            spots = self._reflectors(detector.scanner, scan, count)
            line["reflectors"] = [dataclasses.asdict(spot) for spot in spots]
            if picture is not None:
                self._draw(scan, line, spots, picture)
        return line

    def _air(self, temperature_c: float | None, humidity_percent: float | None) -> Air:
        """As asked, as the ping says, or as the recording says, in this order."""
        from ertis_daemon.pipeline import rounded
        from ertis_detector.air import Air

        args, info = self._args, self._info
        degrees = (args.temperature_c, temperature_c, info.temperature_c)
        percent = (args.humidity_percent, humidity_percent, info.humidity_percent)
        return rounded(Air.measured(_first(degrees), _first(percent)))

    def _detector(self, air: Air) -> LandmarkDetector:
        from ertis_daemon.pipeline import build_detector

        if air not in self._detectors:
            if len(self._detectors) >= _MAX_DETECTORS:
                self._detectors.clear()
            self._detectors[air] = build_detector(
                self._settings,
                air,
                self._args.model or "",
                self._args.min_probability,
            )
        return self._detectors[air]

    def _reflectors(self, scanner: Scanner, scan: Scan, count: int) -> list[Reflector]:
        from ertis_detector.reflectors import strongest

        return strongest(scanner, scan.baseband, scan.scape, count) if count else []

    def _draw(
        self, scan: Scan, line: dict[str, Any], spots: list[Reflector], picture: Path
    ) -> None:
        from ertis_daemon.picture import draw

        title = f"{self._args.file.name}, ping {line['ping_index']} ({_SAID[self._source]})"
        places = [
            (
                f"{one['class']} {one['probabilities'][one['class']]:.2f}",
                one["range_m"],
                one["azimuth_rad"],
            )
            for one in line["landmarks"]
        ]
        draw(scan.scape, places, spots, title, picture)


def _first(values: Iterable[float | None]) -> float | None:
    return next((value for value in values if value is not None), None)


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


def _text(line: dict[str, Any]) -> str:
    import math

    found = [
        f"{one['class']} ({one['probabilities'][one['class']]:.2f}) at {one['range_m']:.3f} m, "
        f"{math.degrees(one['azimuth_rad']):+.1f} deg"
        for one in line["landmarks"]
    ]
    text = f"ping {line['ping_index']} [{line['source']}]: {'; '.join(found) or 'no landmark'}"
    for spot in line.get("reflectors", []):
        text += (
            f"\n  reflector {spot['range_m']:.3f} m, {math.degrees(spot['azimuth_rad']):+.1f} deg, "
            f"{math.degrees(spot['elevation_rad']):+.1f} deg up, {spot['level_db']:.1f} dB"
        )
    return text
