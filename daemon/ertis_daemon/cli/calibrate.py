"""``ertis calibrate``: a model as sure as it may be where you have recorded."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ertis_daemon.cli.before_work import add_workers, check_output, check_workers
from ertis_driver.errors import SettingsError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "recordings",
        nargs="*",
        type=Path,
        help="MCAP recordings with truth, and folders of labelled data sets: 200 pings or more, "
        "of three scenes or sessions or more, with landmarks and without",
    )
    parser.add_argument(
        "--drives",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help="MCAP recordings of drives without a landmark in hearing, half an hour or more: what "
        "is announced is then as seldom wrong there as the configuration asks, and no more seldom",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="model file")
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="default: the one shipped for the chirp"
    )
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Calibrate, save, and say what it won."""
    from ertis_daemon.calibrating import calibrate, calibrate_tracker
    from ertis_daemon.cli.train import save, show_pings
    from ertis_daemon.labelled import each_once
    from ertis_daemon.training import first_chirp
    from ertis_detector.false_tracks import FalseTracks
    from ertis_detector.model import load_model, shipped_model

    if not (args.recordings or args.drives):
        raise SettingsError("nothing to calibrate with: name labelled recordings, or --drives")
    check_workers(args.workers)
    check_output(args.output)
    each_once(args.drives)
    told: dict[str, float] = {}
    if args.recordings:
        made = calibrate(args.recordings, args.model, args.workers, show_pings)
        model = made.model
        told = {
            "slope": round(made.law.slope, 3),
            "offset": round(made.law.offset, 3),
            "unknown_offset": round(made.law.unknown_offset, 3),
            "expected_calibration_error": round(made.as_told, 4),
            "expected_calibration_error_elsewhere": round(made.elsewhere, 4),
        }
    else:
        chirp, _ = first_chirp(args.drives)
        model = load_model(args.model or shipped_model(chirp.name))
    if args.drives:
        model = calibrate_tracker(model, args.drives, args.workers, show_pings)
    save(model, args.output)
    card = model.card
    said = {
        "model": str(args.output),
        "source": card.source,
        **told,
        "min_probability": card.min_probability,
        **card.figures,
        **(law.figures() if (law := FalseTracks.from_figures(card.tracking)) else {}),
    }
    print(json.dumps(said))
    return 0
