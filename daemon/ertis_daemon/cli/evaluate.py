"""``ertis evaluate``: how good a detector, or a method that is told the range, is on data."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.before_work import add_workers, check_output, check_workers

if TYPE_CHECKING:
    from ertis_daemon.report.page import Page


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "data", nargs="+", type=Path, help="folder of a labelled data set, or recording with truth"
    )
    parser.add_argument(
        "--protocol",
        choices=["paper"],
        help="the paper's experiment: range told, cross-validated; of one data set",
    )
    parser.add_argument("--html", type=Path, metavar="PAGE", help="write a self-contained page")
    parser.add_argument("--json", action="store_true", help="one JSON object, shares of 1")
    add_workers(parser)
    detector = parser.add_argument_group("without --protocol: the detector, range not told")
    detector.add_argument(
        "--model", type=Path, metavar="FILE", help="default: the one shipped for the chirp"
    )
    detector.add_argument(
        "--min-probability", type=float, metavar="P", help="default: the model's own"
    )
    detector.add_argument(
        "--rate",
        type=float,
        default=7.0,
        metavar="HZ",
        help="pings a second that false alarms are told for (default 7)",
    )
    paper = parser.add_argument_group("with --protocol paper")
    paper.add_argument(
        "--methods", default="", metavar="A,B", help="default: all; the first is compared with"
    )
    paper.add_argument(
        "--choice",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="make one of the paper's open choices otherwise; may be given again",
    )
    paper.add_argument(
        "--sweep", action="store_true", help="every alternative of every open choice, one by one"
    )
    paper.add_argument("--repeats", type=int, default=20, metavar="N", help="of the random folds")
    paper.add_argument("--folds", type=int, default=10, metavar="N", help="random folds")
    paper.add_argument("--seed", type=int, default=1, metavar="N", help="of the random folds")


def run(args: argparse.Namespace) -> int:
    """Evaluate, print the figures, and write the page if one is wanted."""
    from ertis_daemon.report.page import write_page

    check_workers(args.workers)
    if args.html is not None:
        _check_page(args.html, args.data)
    text, said, page = _known_range(args) if args.protocol else _detector(args)
    if page is not None:
        write_page(page, args.html)
    print(json.dumps(said, allow_nan=False) if args.json else text)
    return 0


def _known_range(args: argparse.Namespace) -> tuple[str, dict[str, Any], Page | None]:
    from ertis_daemon.report import known_range_page
    from ertis_daemon.report.known_range import KnownRangeSpec, evaluate_known_range
    from ertis_daemon.report.methods import METHODS, build_methods
    from ertis_detector.paper import PaperMethod
    from ertis_detector.paper_choices import PaperChoices
    from ertis_driver.dataset import open_dataset
    from ertis_driver.errors import SettingsError

    if len(args.data) > 1:
        raise SettingsError(f"--protocol takes one data set, met {len(args.data)}")
    for name, value, least in (("--repeats", args.repeats, 1), ("--folds", args.folds, 2)):
        if value < least:
            raise SettingsError(f"{name} {value}, expected {least} at least")
    choices = PaperChoices().changed(args.choice)
    methods = build_methods(args.methods.split(",") if args.methods else list(METHODS))
    for number, method in enumerate(methods):
        if isinstance(method, PaperMethod):
            methods[number] = PaperMethod(method.choices.changed(args.choice), method.name)
    spec = KnownRangeSpec(choices, args.repeats, args.folds, args.seed, args.sweep)
    report = evaluate_known_range(open_dataset(args.data[0]), methods, spec, args.workers, _show)
    page = known_range_page.page(report, _command(args)) if args.html else None
    return known_range_page.text(report), known_range_page.as_json(report), page


def _detector(args: argparse.Namespace) -> tuple[str, dict[str, Any], Page | None]:
    from ertis_daemon.report import detector_page
    from ertis_daemon.report.detector_data import judge
    from ertis_driver.errors import SettingsError

    if not 0 < args.rate <= 1000:
        raise SettingsError(f"--rate {args.rate:g}, expected above 0, up to 1000")
    if args.min_probability is not None and not 0 < args.min_probability <= 1:
        raise SettingsError(
            f"--min-probability {args.min_probability:g}, expected above 0, up to 1"
        )
    report = judge(
        args.data,
        args.model,
        min_probability=args.min_probability,
        rate_hz=args.rate,
        workers=args.workers,
        progress=_show,
    )
    page = detector_page.page(report, _command(args)) if args.html else None
    return detector_page.text(report), detector_page.as_json(report), page


def _check_page(path: Path, data: Sequence[Path]) -> None:
    """Fail before the work, not after it.

    Raises
    ------
    ErtisError
        If the page cannot be drawn or written, or would overwrite what is no page.
    """
    from importlib.util import find_spec

    from ertis_driver.errors import ErtisError, SettingsError

    if path.suffix.lower() not in (".html", ".htm"):
        raise SettingsError(f"--html {path}, expected a name that ends in .html")
    if path.resolve() in [one.resolve() for one in data]:
        raise SettingsError(f"--html {path} would overwrite the data: name another file")
    if find_spec("matplotlib") is None:
        raise ErtisError("--html needs matplotlib: pip install 'ertis[plot]'")
    check_output(path)


def _show(what: str, done: int, of: int) -> None:
    if sys.stderr.isatty():
        end = "\n" if done == of else ""
        print(f"\r{what}: {done} of {of}", end=end, file=sys.stderr, flush=True)


def _command(args: argparse.Namespace) -> str:
    """The command that makes the page again, without what only says where things go."""
    words = ["ertis", "evaluate", *map(str, args.data)]
    if args.protocol:
        words += ["--protocol", args.protocol]
        words += ["--methods", args.methods] if args.methods else []
        for one in args.choice:
            words += ["--choice", one]
        words += ["--sweep"] if args.sweep else []
        words += ["--repeats", str(args.repeats), "--folds", str(args.folds)]
        words += ["--seed", str(args.seed)]
    else:
        words += ["--model", str(args.model)] if args.model else []
        if args.min_probability is not None:
            words += ["--min-probability", f"{args.min_probability:g}"]
        words += ["--rate", f"{args.rate:g}"]
    words += ["--html", str(args.html)]
    return shlex.join(words)
