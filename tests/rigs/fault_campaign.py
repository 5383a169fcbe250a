"""Thousands of seeded faults between the emulated firmware and the real driver, on real ptys.

As a command it prints the fault table: ``python tests/rigs/fault_campaign.py --faults 10000``.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import os
import statistics
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from fault_session import ASKED, TIMEOUT_S, UNASKED, Outcome, Session

from ertis_driver.fault_plan import draw_fault
from ertis_driver.protocol import frame_bytes

NUM_PROCESSES = 2
NUM_THREADS = 32  # a case mostly waits for a timeout; 22 file descriptors each, of 1024
CASE_DEADLINE_S = 60.0  # hundreds of times what a case takes
FRAME_BYTES = frame_bytes(32_768)

# How many of each kind in 10,000. What costs a second is rarer than what costs milliseconds.
WEIGHTS = {
    "frame": "drop 1000 double 800 insert 800 flip 900 magic 500 truncate 500 jump 300 late 300 "
    "stall 300 silent 200 reset 100 vanish 200 babble 50",
    "unasked": "drop 900 double 700 insert 700 flip 500 magic 300 truncate 300 jump 100 stall 50 "
    "reset 30 vanish 30",
    "reply": "drop 80 double 80 insert 80 flip 80 late 30 stall 30 silent 20 vanish 20 reset 10 "
    "babble 10",
}
BYTE_KINDS = ("drop", "double", "insert", "magic", "flip magic", "flip payload", "truncate")
CHOICES = [
    (kind, unit, int(weight))
    for unit, text in WEIGHTS.items()
    for kind, weight in zip(text.split()[::2], text.split()[1::2], strict=True)
]


@dataclass(slots=True)
class Row:
    """What the faults of one kind did."""

    injected: int = 0
    detected: Counter[str] = field(default_factory=Counter)
    lost: list[int] = field(default_factory=list)
    recovery_s: list[float] = field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count one case."""
        self.injected += 1
        self.detected.update(outcome.errors or ["-"])
        self.lost.append(outcome.frames_lost)
        self.recovery_s.append(outcome.recovery_s)


def draw_case(seed: int, number: int):
    """Fault, unit and countdown of one case; the same whatever ran before it."""
    rng = np.random.default_rng([seed, number])
    share = np.array([weight for _, _, weight in CHOICES], float)
    kind, unit, _ = CHOICES[rng.choice(len(share), p=share / share.sum())]
    fault = draw_fault(rng, kind, 4 if unit == "reply" else FRAME_BYTES)
    if kind in ("flip", "drop") and unit != "reply" and rng.random() < 0.5:
        # Where the framing is.
        fault = replace(fault, byte=int(rng.choice([*range(8), *range(-4, 0)]) % FRAME_BYTES))
    if kind == "stall":
        fault = replace(fault, seconds=round(float(rng.uniform(0.0, 4 * TIMEOUT_S)), 3))
    if kind == "babble":
        fault = replace(fault, seconds=round(float(rng.uniform(0.0, 5 * TIMEOUT_S)), 3))
    if kind == "vanish":
        fault = replace(fault, away=round(float(rng.uniform(0.0, 0.05)), 3))
    return fault, unit, int(rng.integers(1000))


def name_of(fault, unit) -> str:
    """The table's row. A flip is named by place: no framing can show one in payload or index."""
    kind = fault.kind
    if kind == "flip" and unit != "reply":
        framing = "index" if 4 <= fault.byte < 8 else "magic"
        kind += f" {'payload' if 8 <= fault.byte < FRAME_BYTES - 4 else framing}"
    return f"{kind}, {unit}"


class Campaign:
    """The cases of one process, by threads that take the next when they are done."""

    def __init__(self, seed: int, numbers: list[int]) -> None:
        self.rows: dict[str, Row] = {}
        self.failures: list[str] = []
        self._seed = seed
        self._numbers = iter(numbers)
        self._lock = threading.Lock()
        self._busy: dict[int, tuple[int, float]] = {}
        self._done = threading.Event()

    def run(self, num_threads: int) -> None:
        """All of them; ends the process if one hangs."""
        watchdog = threading.Thread(target=self._watch, daemon=True)
        threads = [threading.Thread(target=self._work) for _ in range(num_threads)]
        for thread in (watchdog, *threads):
            thread.start()
        for thread in threads:
            thread.join()
        self._done.set()

    def _watch(self) -> None:
        while not self._done.wait(0.5):
            for number, started_s in list(self._busy.values()):
                if time.monotonic() - started_s > CASE_DEADLINE_S:
                    print(f"case {number} of seed {self._seed} hangs", file=sys.stderr)
                    faulthandler.dump_traceback(all_threads=True)
                    os._exit(70)

    def _work(self) -> None:
        sessions: dict[str, Session] = {}
        try:
            while True:
                with self._lock:
                    number = next(self._numbers, None)
                if number is None or len(self.failures) >= 10:
                    break
                self._busy[threading.get_ident()] = number, time.monotonic()
                self._case(sessions, number)
        finally:
            self._busy.pop(threading.get_ident(), None)
            for session in sessions.values():
                session.close()

    def _case(self, sessions: dict[str, Session], number: int) -> None:
        fault, unit, countdown = draw_case(self._seed, number)
        mode = "unasked" if unit == "unasked" else "asked"
        try:
            if mode not in sessions:
                sessions[mode] = Session(UNASKED if unit == "unasked" else ASKED)
            outcome = sessions[mode].run(fault, unit, countdown)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is the driver's or ours
            with self._lock:
                self.failures.append(
                    f"case {number} of seed {self._seed}, {fault} on {unit}: "
                    f"{type(error).__name__}: {error}"
                )
            if mode in sessions:
                sessions.pop(mode).close()
            return
        with self._lock:
            self.rows.setdefault(name_of(fault, unit), Row()).add(outcome)


def run_part(seed: int, numbers: list[int], num_threads: int):
    """One process' share."""
    logging.disable(logging.CRITICAL)
    campaign = Campaign(seed, numbers)
    campaign.run(num_threads)
    return campaign.rows, campaign.failures


def run_campaign(seed: int, num_faults: int, num_processes: int = NUM_PROCESSES):
    """All cases; returns rows by name, and what was wrong, in words."""
    rows: dict[str, Row] = {}
    failures: list[str] = []
    parts = [list(range(start, num_faults, num_processes)) for start in range(num_processes)]
    with ProcessPoolExecutor(num_processes, get_context("spawn")) as pool:
        for part, wrong in pool.map(run_part, [seed] * len(parts), parts, [NUM_THREADS] * 9):
            failures += wrong
            for name, row in part.items():
                total = rows.setdefault(name, Row())
                total.injected += row.injected
                total.detected += row.detected
                total.lost += row.lost
                total.recovery_s += row.recovery_s
    return rows, failures + judge_rows(rows)


def judge_rows(rows: dict[str, Row]) -> list[str]:
    """What is wrong with the rows, in words."""
    wrong: list[str] = []
    for name, row in rows.items():
        kind, unit = name.split(", ")
        silent, mean = row.detected["-"], statistics.mean(row.lost)
        # A ping that was asked for and damaged is an error; one that came unasked is a gap.
        if unit == "frame" and kind in ("drop", "magic", "flip magic", "silent") and silent:
            wrong.append(f"{name}: {silent} without an error")
        if kind in ("flip payload", "jump") and silent < 0.8 * row.injected:
            wrong.append(f"{name}: {row.injected - silent} errors, expected none")
        # Beyond the damaged frame, a busy machine may now and then cost another.
        if kind in BYTE_KINDS and row.injected >= 20 and mean > 1.2:
            wrong.append(f"{name}: {mean:.2f} frames lost in the mean, expected one")
    return wrong


def table(rows: dict[str, Row]) -> str:
    """The fault table as text."""
    lines = [
        f"{'fault':22} {'injected':>8} {'lost max':>8} {'mean':>5} "
        f"{'recovery median':>15} {'max':>8}  detected as"
    ]
    for name, row in sorted(rows.items()):
        met = ", ".join(f"{error} {count}" for error, count in row.detected.most_common())
        lines.append(
            f"{name:22} {row.injected:8} {max(row.lost):8} {statistics.mean(row.lost):5.2f} "
            f"{1e3 * statistics.median(row.recovery_s):12.0f} ms "
            f"{1e3 * max(row.recovery_s):5.0f} ms  {met}"
        )
    return "\n".join(lines)


def main() -> int:
    """Print the table; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faults", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--only", type=int, help="this case alone")
    args = parser.parse_args()
    started_s = time.monotonic()
    if args.only is None:
        rows, failures = run_campaign(args.seed, args.faults)
    else:
        rows, failures = run_part(args.seed, [args.only], 1)
    print(table(rows))
    total = sum(row.injected for row in rows.values())
    print(f"{total} faults in {time.monotonic() - started_s:.0f} s, {len(failures)} wrong")
    for failure in failures:
        print(failure, file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    sys.exit(main())
