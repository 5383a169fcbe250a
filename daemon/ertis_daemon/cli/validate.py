"""``ertis validate``: the simulator held against physics and, if there is one, a real ping."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ertis_simulator.validation.real_ping import PingFigures

TWINS = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "--real",
        type=Path,
        metavar="FILE.bin",
        help="the real ping: rtisdev/simulate.bin of the wheel rtisdev 2.16.0",
    )
    parser.add_argument(
        "--page",
        type=Path,
        metavar="FILE.md",
        help="rewrite the tables between this page's markers",
    )
    parser.add_argument("--images", type=Path, metavar="FOLDER", help="draw validation_*.png there")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(args: argparse.Namespace) -> int:
    """Print every table; exit 1 if a figure is further off than allowed."""
    from ertis_simulator.validation import air_checks, dish_checks, pdm_checks, wave_checks
    from ertis_simulator.validation.page import checks_table, fill, rows_table
    from ertis_simulator.validation.real_ping import compare, figures, pooled
    from ertis_simulator.validation.twin import twin

    # What is wrong with a file is said before the minutes that this takes.
    page = None if args.page is None else _page(args.page)
    real_words = None if args.real is None else _real_words(args.real)
    groups = {
        "dish": dish_checks,
        "air": air_checks,
        "waves": wave_checks,
        "modulator": pdm_checks,
    }
    checks = {name: module.checks() for name, module in groups.items()}
    said: dict[str, Any] = {
        name: [{**dataclasses.asdict(check), "agrees": bool(check.agrees)} for check in found]
        for name, found in checks.items()
    }
    tables = {name: checks_table(found) for name, found in checks.items()}
    failed = sum(not check.agrees for found in checks.values() for check in found)
    if real_words is not None:
        real = figures(real_words)
        simulated = pooled([figures(twin(seed)) for seed in range(TWINS)])
        rows = compare(real, simulated)
        tables["real ping"] = rows_table(rows)
        said["real ping"] = [dataclasses.asdict(row) for row in rows]
        failed += sum(row.allowed is not None and abs(row.difference) > row.allowed for row in rows)
    if args.json:
        print(json.dumps({"source": "sim", "exceeded": failed, **said}))
    else:
        for table in tables.values():
            print(table, end="\n\n")
    if page is not None:
        for name, table in tables.items():
            page = fill(page, name, table)
        args.page.write_text(page, encoding="utf-8")
    if args.images is not None:
        drawn = None if real_words is None else (real_words, real, simulated)
        _draw(args.images, drawn)
    return 1 if failed else 0


def _page(path: Path) -> str:
    """A page that can be rewritten.

    Raises
    ------
    ErtisError
        If it cannot.
    """
    from ertis_driver.errors import ErtisError

    try:
        with path.open("r+", encoding="utf-8") as file:
            return file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise ErtisError(f"cannot rewrite {path}: {error}") from error


def _real_words(path: Path) -> npt.NDArray[np.uint32]:
    """The first frame of a recording; its chirp must be the incumbent's.

    Raises
    ------
    RecordingError
    """
    from ertis_driver.errors import RecordingError
    from ertis_driver.frame import DEFAULT_NUM_WORDS
    from ertis_driver.recording import open_recording

    first = next(iter(open_recording(path)), None)
    if first is None:
        raise RecordingError(f"{path} holds no ping, expected a real one")
    words = first.frame.words
    if words.size != DEFAULT_NUM_WORDS:
        raise RecordingError(
            f"{path}: frames of {words.size} words, expected the default {DEFAULT_NUM_WORDS}"
        )
    return words


def _draw(
    folder: Path, real: tuple[npt.NDArray[np.uint32], PingFigures, PingFigures] | None
) -> None:
    from ertis_driver.errors import ErtisError

    try:
        from ertis_simulator.validation import plots
    except ImportError as error:
        raise ErtisError("--images needs matplotlib: pip install 'ertis[plot]'") from error
    folder.mkdir(parents=True, exist_ok=True)
    plots.chain(folder / "validation_chain.png")
    if real is not None:
        words, measured, simulated = real
        plots.noise(folder / "validation_noise.png", words)
        plots.ping(folder / "validation_ping.png", measured, simulated, TWINS)
