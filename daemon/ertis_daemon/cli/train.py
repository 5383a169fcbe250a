"""``ertis train``: a model from recordings with truth."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from ertis_daemon.cli.before_work import add_workers, check_output, check_workers

if TYPE_CHECKING:
    from ertis_detector.model import Model


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        help="MCAP recordings with truth, and folders of labelled data sets",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        help="model file; a folder gets one named after the chirp",
    )
    parser.add_argument(
        "--calibrate",
        nargs="+",
        default=(),
        type=Path,
        metavar="RECORDING",
        help="other recordings with truth, kept for how sure to be: probabilities, the threshold, "
        "covariances, the figures said; default: cross-validation, which takes six times as long",
    )
    parser.add_argument("--name", help="what events call the model; default from the chirp")
    add_workers(parser)


def run(args: argparse.Namespace) -> int:
    """Train, save, and say what it is worth on scenes left out."""
    from ertis_daemon.training import train
    from ertis_detector.model import model_file_name

    check_workers(args.workers)
    check_output(args.output, may_be_folder=True)
    name = args.name or ""
    model = train(args.recordings, name, args.workers, show_pings, calibrate=args.calibrate)
    path = args.output / model_file_name(model.card.chirp) if args.output.is_dir() else args.output
    save(model, path)
    card = model.card
    said = {"model": str(path), "source": card.source, "min_probability": card.min_probability}
    print(json.dumps({**said, **card.figures}))
    return 0


def show_pings(pings: int) -> None:
    """How many were read, where somebody looks on."""
    if sys.stderr.isatty():
        print(f"\r{pings} pings read", end="", file=sys.stderr)


def save(model: Model, path: Path) -> None:
    """Write a model.

    Raises
    ------
    ErtisError
        If it cannot be written.
    """
    from ertis_detector.model import save_model
    from ertis_driver.errors import ErtisError

    if sys.stderr.isatty():
        print(file=sys.stderr)
    try:
        save_model(model, path)
    except OSError as error:
        raise ErtisError(f"cannot write {path}: {error.strerror}") from error
