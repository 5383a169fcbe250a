"""How fast it is, against what a user would write and against what the machine allows.

``python tests/bench/bench.py [--rounds N] [--reference FILE]``. It prints and judges; it never
fails, as another machine, or a busy one, is no defect. One thread, one core, random order.
"""

from __future__ import annotations

import argparse
import os
import platform
from pathlib import Path

from ertis_daemon.blas import settle_blas


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--reference", type=Path, help="a headerless recording of one ping")
    args = parser.parse_args()
    # BLAS reads them once, when numpy is first imported: hence the imports below.
    settle_blas()
    os.environ["MKL_NUM_THREADS"] = "1"
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

    import numpy as np
    import scipy
    from contests import bench_all, bench_proposals, demo_words
    from simulation import bench_simulation

    from ertis_daemon.memory import keep_freed_memory
    from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
    from ertis_driver.frame import DEFAULT_NUM_WORDS

    keep_freed_memory()  # as the daemon does
    print(
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}; one thread, one core"
    )
    bench_simulation()
    bench_all("simulated demo scene", demo_words(DEFAULT_CHIRP), DEFAULT_CHIRP, args.rounds)
    print("\n=== proposals ===")
    bench_proposals(DEFAULT_CHIRP, args.rounds, np.random.default_rng(2))
    if args.reference:
        words = np.fromfile(args.reference, "<u4").astype(np.uint32)[:DEFAULT_NUM_WORDS]
        bench_all(args.reference.name, words, INCUMBENT_CHIRP, args.rounds)


if __name__ == "__main__":
    main()
