"""``python -m ertis_simulator.bound``: make the tables, or say what they mean for a data set."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ertis_driver.errors import ErtisError
from ertis_simulator.bound.expected import expected, read_landmarks
from ertis_simulator.bound.table import (
    ARRAY,
    BEAM,
    place_rows,
    read_sizes,
    size_rows,
    write_rows,
)

SIZES, PLACES = "bound.csv", "bound_place.csv"


def main(arguments: list[str] | None = None) -> int:
    """Return 0, or 1 if a file or data set is of no use."""
    parser = argparse.ArgumentParser(prog="python -m ertis_simulator.bound", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder of the tables")
    parser.add_argument("--trials", type=int, default=40, help="of each size, tilt and ratio")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--dataset",
        type=Path,
        help="look up a simulated data set in the tables there are, and make none",
    )
    args = parser.parse_args(arguments)
    try:
        if args.dataset is None:
            _make(args.out, args.trials, args.seed)
        else:
            _look_up(args.out / SIZES, args.dataset)
    except (ErtisError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


def _make(folder: Path, trials: int, seed: int) -> None:
    def tell(text: str) -> None:
        sys.stderr.write(f"{text}\n")

    write_rows(folder / PLACES, list(place_rows()))
    write_rows(folder / SIZES, list(size_rows(trials, seed, progress=tell)))


def _look_up(table: Path, dataset: Path) -> None:
    rows, heard = read_sizes(table), read_landmarks(dataset)
    sys.stdout.write(f"{len(heard.label)} landmarks, simulated; best possible, one ping:\n")
    sys.stdout.write("receiver  size (level and range told)  (level told)  (nothing)  detected\n")
    for kind in (BEAM, ARRAY):
        found = expected(rows, kind, heard)
        sys.stdout.write(
            f"{kind:8}  {found.told:28.3f}  {found.level:12.3f}  {found.free:9.3f}  "
            f"{found.detected:8.3f}\n"
        )


if __name__ == "__main__":
    sys.exit(main())
