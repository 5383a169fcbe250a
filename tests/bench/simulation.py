"""How fast scenes are heard: a live one on all cores, a ping's parts, pings of a data set."""

from __future__ import annotations

import os
import time
from importlib import resources

import numpy as np
from timing import print_target

from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS, PDM_RATE_HZ
from ertis_simulator.device import SimulatedSonar
from ertis_simulator.paper_dataset import PAPER_PINGS, VARIANTS, build_scene, plan
from ertis_simulator.scene import Scene
from ertis_simulator.scene_file import load_scene

CEILING_HZ = PDM_RATE_HZ / DEFAULT_NUM_WORDS  # 27.5: a frame takes 36.4 ms to listen to
_ASLEEP_HZ = 0.1  # it is never faster; a sleep that ends late takes a little
DATASET_S = 600.0  # for the paper's 944 pings on two cores
_LIVE_PINGS, _LIVE_ROUNDS, _DATASET_PINGS = 20, 7, 14


def scene(name: str) -> Scene:
    with resources.as_file(resources.files("ertis_simulator") / f"scenes/{name}.yaml") as path:
        return load_scene(path)


def bench_simulation() -> None:
    """Print CPU time a ping as well: that of a busy machine says nothing else."""
    print("\n=== simulation ===")
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    for name in ("demo", "office"):
        made = scene(name)
        made.hear(0, DEFAULT_NUM_WORDS, chirp)  # compiled, tables made
        times, cpu = [], time.process_time()
        for index in range(10):
            start = time.perf_counter()
            made.hear(index, DEFAULT_NUM_WORDS, chirp)
            times.append(time.perf_counter() - start)
        cpu = time.process_time() - cpu
        echoes = len(made.echoes(0).path_m)
        print(
            f"  {name}: {echoes} echoes, one ping min {1e3 * min(times):.1f} ms, median "
            f"{1e3 * np.median(times):.1f} ms, CPU {100 * cpu:.1f} ms"
        )
        _live(name, made)
    _dataset(chirp)


def _live(name: str, made: Scene) -> None:
    """As ``sim:SCENE`` gives them on every core there is: no faster than a real sonar would."""
    own = os.sched_getaffinity(0) if hasattr(os, "sched_setaffinity") else None
    if own is not None:
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    rates = []
    with SimulatedSonar(made) as sonar:
        sonar.configure(Settings())
        sonar.ping()
        cpu = time.process_time()
        for _ in range(_LIVE_ROUNDS):
            start = time.perf_counter()
            for _ in range(_LIVE_PINGS):
                sonar.ping()
            rates.append(_LIVE_PINGS / (time.perf_counter() - start))
        cpu = (time.process_time() - cpu) / (_LIVE_PINGS * _LIVE_ROUNDS)
    if own is not None:
        os.sched_setaffinity(0, own)
    rate = float(np.median(rates))
    cores = os.cpu_count() or 1
    print(
        f"  sim:{name}.yaml live: {rate:.2f} pings/s ({min(rates):.1f} to {max(rates):.1f}), "
        f"{rate / CEILING_HZ:.3f} of a real sonar's, {1e3 * cpu:.0f} ms CPU each"
    )
    print_target(f"sim:{name}.yaml on {cores} cores, pings/s", rate, CEILING_HZ - _ASLEEP_HZ)
    print_target(f"sim:{name}.yaml on two free cores, pings/s", 2 / cpu, CEILING_HZ)


def _dataset(chirp: np.ndarray) -> None:
    """One ping of each environment, twice; the rest is as many of them."""
    pings = plan(_DATASET_PINGS)
    build_scene(1, pings[0], VARIANTS["paper"]).scene.hear_and_judge(0, DEFAULT_NUM_WORDS, chirp)
    cpu = time.process_time()
    for ping in pings:
        made = build_scene(1, ping, VARIANTS["paper"]).scene
        made.hear_and_judge(ping.number, DEFAULT_NUM_WORDS, chirp)
    each = (time.process_time() - cpu) / len(pings)
    print(f"  data set: CPU {1e3 * each:.0f} ms a ping, {1 / each:.1f} pings/s a core")
    text = f"s for {PAPER_PINGS} pings on two free cores (from CPU time)"
    print_target(text, PAPER_PINGS * each / 2, DATASET_S, at_most=True)
