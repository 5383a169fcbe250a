"""``ertis calibrate``: a model whose probabilities come true where you have recorded."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ertis_daemon.cli.before_work import add_workers, check_output, check_workers


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        help="MCAP recordings with truth, and folders of labelled data sets: 200 pings or more, "
        "of three scenes or sessions or more, with landmarks and without",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="model file")
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="default: the one shipped for the chirp"
    )
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Calibrate, save, and say what it won."""
    from ertis_daemon.calibrating import calibrate
    from ertis_daemon.cli.train import save, show_pings

    check_workers(args.workers)
    check_output(args.output)
    made = calibrate(args.recordings, args.model, args.workers, show_pings)
    save(made.model, args.output)
    card = made.model.card
    said = {
        "model": str(args.output),
        "source": card.source,
        "slope": round(made.law.slope, 3),
        "offset": round(made.law.offset, 3),
        "expected_calibration_error": round(made.as_told, 4),
        "expected_calibration_error_elsewhere": round(made.elsewhere, 4),
        "min_probability": card.min_probability,
    }
    print(json.dumps({**said, **card.figures}))
    return 0
