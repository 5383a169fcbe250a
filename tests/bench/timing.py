"""Rounds in random order, so that a busy neighbour hits every contender alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np


def measure(
    contenders: Mapping[str, Callable[[], object]], rounds: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Time each contender once a round, in another order each time.

    Returns
    -------
    dict of name -> float64, shape (rounds,), ms
    """
    names = list(contenders)
    for name in names:
        contenders[name]()  # first call: caches, plans, buffers
    times = {name: np.zeros(rounds) for name in names}
    for number in range(rounds):
        for name in rng.permutation(names):
            start = time.perf_counter()
            contenders[name]()
            times[name][number] = (time.perf_counter() - start) * 1e3
    return times


def print_table(title: str, times: Mapping[str, np.ndarray], ours: str) -> None:
    """Minimum and median of each contender, and how many times ours it takes."""
    print(f"\n{title}")
    print(f"  {'':44s} {'min ms':>9s} {'median':>9s} {'min/min':>9s} {'med/med':>9s}")
    own = times[ours]
    for name, values in times.items():
        low, middle = values.min() / own.min(), np.median(values) / np.median(own)
        print(
            f"  {name:44s} {values.min():9.2f} {np.median(values):9.2f} {low:8.1f}x {middle:8.1f}x"
        )


def print_target(text: str, reached: float, wanted: float, *, at_most: bool = False) -> None:
    """One goal: what was asked for, and what came out."""
    sign, met = ("<=", reached <= wanted) if at_most else (">=", reached >= wanted)
    print(
        f"  {text:52s} {sign} {wanted:6.1f}   reached {reached:7.1f}   {'ok' if met else 'MISSED'}"
    )
