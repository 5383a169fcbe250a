"""Make the stored table again: ``python -m ertis_simulator.reference TABLE.npz``."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from ertis_simulator.reference.table import TABLE_KA, ReferenceTable, table_views


def main() -> None:
    """Solve for every entry and write the file; progress goes to stderr."""
    parser = argparse.ArgumentParser(description="Exact echoes of the landmark's dish.")
    parser.add_argument("table", type=Path, help="npz file to write")
    path = parser.parse_args().table
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    ReferenceTable.compute(TABLE_KA, table_views()).save(path)


if __name__ == "__main__":
    main()
