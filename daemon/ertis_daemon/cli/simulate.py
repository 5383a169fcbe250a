"""``ertis simulate``: recordings of simulated scenes, and labelled data sets, with truth."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from functools import lru_cache
from itertools import count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.cli.before_work import check_output

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ertis_driver.chirp import Chirp
    from ertis_simulator.scene import Scene

    # A scene, or seed and number of a random one or of a drive; the ping of it; the chirp.
    Job = tuple[Scene | tuple[str, int, int], int, str]

_DEFAULT_PINGS = 10
_NS = 1_000_000_000
_PERIOD_NS = _NS // 10
_BETWEEN_DRIVES_NS = 60 * _NS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("scene", nargs="?", type=Path, help="YAML scene to play")
    what.add_argument(
        "--random", action="store_true", help="a new random scene for each ping, to train on"
    )
    what.add_argument(
        "--drives",
        action="store_true",
        help="drives through random rooms without a landmark, to calibrate a tracker with",
    )
    what.add_argument(
        "--dataset",
        type=Path,
        metavar="DIR",
        help="a labelled data set like the paper's: 944 pings in seven environments",
    )
    parser.add_argument("-o", "--output", type=Path, help="MCAP file to make")
    parser.add_argument(
        "--plot", type=Path, metavar="OUT.png", help="draw the scene's first ping and its plan"
    )
    parser.add_argument(
        "-n", "--pings", type=int, metavar="N", help="default 10, of a data set 944"
    )
    parser.add_argument("--seed", type=int, default=1, help="of what is random, default 1")
    parser.add_argument(
        "--variant", default="paper", metavar="NAME", help="harder data sets; 'help' lists them"
    )
    parser.add_argument(
        "-j", "--workers", type=int, metavar="N", help="processes, default one for each core"
    )
    parser.add_argument(
        "--chirp", metavar="KIND:START:STOP:SECONDS", help="default hyperbolic:80000:20000:0.0025"
    )
    parser.add_argument(
        "--json", action="store_true", help="print what was made as one JSON object"
    )


def run(args: argparse.Namespace) -> int:
    """Make what was asked for, on all cores."""
    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.errors import SettingsError

    for name, value, least in (
        ("--pings", args.pings, 1),
        ("--workers", args.workers, 1),
        ("--seed", args.seed, 0),
    ):
        if value is not None and value < least:
            raise SettingsError(f"{name} {value}, expected {least} or more")
    chirp = Chirp.parse(args.chirp) if args.chirp else DEFAULT_CHIRP
    if args.dataset is not None:
        return _dataset(args, chirp)
    if args.variant != "paper":
        raise SettingsError(
            f"--variant {args.variant} without --dataset: variants are of data sets"
        )
    if args.plot is not None and args.scene is None:
        raise SettingsError("--plot draws a scene of yours: name its file, or leave --plot out")
    if args.output is None and args.plot is None:
        raise SettingsError("nothing to make: name a recording with -o, or a picture with --plot")
    for output in filter(None, (args.output, args.plot)):
        check_output(output)
    if args.plot is not None:
        _plot(args, chirp)
    if args.output is not None:
        _record(args, chirp)
    if args.json:
        pings = _num_pings(args) if args.output is not None else 0
        print(
            json.dumps({"recording": _text(args.output), "plot": _text(args.plot), "pings": pings})
        )
    return 0


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _num_pings(args: argparse.Namespace) -> int:
    return _DEFAULT_PINGS if args.pings is None else int(args.pings)


def _dataset(args: argparse.Namespace, chirp: Chirp) -> int:
    from ertis_driver.errors import SettingsError
    from ertis_simulator.dataset_files import DatasetSpec, make_dataset
    from ertis_simulator.paper_dataset import PAPER_PINGS, VARIANTS

    if args.variant == "help":
        for name, variant in VARIANTS.items():
            print(f"{name:14s}{variant.about}")
        return 0
    if args.variant not in VARIANTS:
        raise SettingsError(f"--variant {args.variant}, expected one of {', '.join(VARIANTS)}")
    if args.output is not None or args.plot is not None:
        raise SettingsError("--dataset DIR says where it goes: leave out -o and --plot")
    num_pings = PAPER_PINGS if args.pings is None else args.pings
    spec = DatasetSpec(args.seed, num_pings, args.variant, chirp.name)
    _show(0, num_pings)
    try:
        made = make_dataset(args.dataset, spec, _workers(args), lambda done: _show(done, num_pings))
    finally:
        _end_progress()
    if args.json:
        print(json.dumps({"dataset": str(args.dataset), "pings": num_pings, "made_now": made}))
        return 0
    print(f"{args.dataset}: {num_pings} simulated pings, {made} of them made now", file=sys.stderr)
    return 0


def _record(args: argparse.Namespace, chirp: Chirp) -> None:
    from multiprocessing import get_context

    from ertis_driver.errors import RecordingError
    from ertis_driver.frame import DEFAULT_NUM_WORDS, PdmFrame
    from ertis_driver.recording import RecordingInfo, RecordingWriter

    num_pings = _num_pings(args)
    jobs, times_ns = zip(*_jobs(args, chirp, num_pings), strict=True)
    info = RecordingInfo("sim", chirp, DEFAULT_NUM_WORDS, address=_address(args))
    if args.output.exists():
        raise RecordingError(f"{args.output} exists: name another file, or remove it")
    # Whole or not at all: beside its place until it is done.
    part = args.output.with_name(args.output.name + ".part")
    part.unlink(missing_ok=True)
    _show(0, num_pings)
    try:
        with (
            RecordingWriter(part, info) as writer,
            get_context("spawn").Pool(_workers(args)) as pool,
        ):
            for index, (words, truth) in enumerate(pool.imap(_hear, jobs, chunksize=4)):
                air = {name: truth[name] for name in ("temperature_c", "humidity_percent")}
                writer.write(PdmFrame(words, index, times_ns[index]), truth, **air)
                _show(index + 1, num_pings)
        part.replace(args.output)
    finally:
        part.unlink(missing_ok=True)
        _end_progress()


def _plot(args: argparse.Namespace, chirp: Chirp) -> None:
    from ertis_daemon.scene_picture import draw_scene
    from ertis_simulator.scene_file import load_scene

    draw_scene(load_scene(args.scene), chirp, args.plot)


def _show(done: int, total: int) -> None:
    if sys.stderr.isatty():
        hint = "" if done else " (compiling first, once on a machine: half a minute)"
        print(f"\rsimulated {done}/{total}{hint}\x1b[K", end="", file=sys.stderr, flush=True)


def _end_progress() -> None:
    if sys.stderr.isatty():
        print(file=sys.stderr)


def _workers(args: argparse.Namespace) -> int:
    return args.workers or os.cpu_count() or 1


def _address(args: argparse.Namespace) -> str:
    if args.scene is not None:
        return f"sim:{args.scene.name}"
    return f"{'random' if args.random else 'drives'} seed {args.seed}"


def _jobs(args: argparse.Namespace, chirp: Chirp, num_pings: int) -> Iterator[tuple[Job, int]]:
    """Pings, and when they are heard.

    No clock ran: that is counted from the epoch on, so that the file is reproducible.
    """
    from ertis_simulator.scene_file import load_scene

    if args.drives:
        yield from islice(_drives(args.seed, chirp), num_pings)
        return
    scene = None if args.random else load_scene(args.scene)
    for index in range(num_pings):
        job = ("random", args.seed, index), 0
        yield (*(job if scene is None else (scene, index)), chirp.name), index * _PERIOD_NS


def _drives(seed: int, chirp: Chirp) -> Iterator[tuple[Job, int]]:
    start_ns = 0
    for number in count():
        scene, num_pings = _drive(seed, number)
        period_ns = round(scene.ping_period_s * _NS)
        for index in range(num_pings):
            yield (("drive", seed, number), index, chirp.name), start_ns + index * period_ns
        start_ns += num_pings * period_ns + _BETWEEN_DRIVES_NS


@lru_cache(maxsize=1)
def _drive(seed: int, number: int) -> tuple[Scene, int]:
    from ertis_simulator.drives import random_drive

    return random_drive(seed, number)


def _hear(job: Job) -> tuple[npt.NDArray[np.uint32], dict[str, Any]]:
    """Words and truth of one ping; runs in a worker process."""
    from ertis_driver.chirp import Chirp
    from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS
    from ertis_simulator.dataset import random_scene

    scene, index, chirp_name = job
    told = {}
    if isinstance(scene, tuple):
        kind, seed, number = scene
        if kind == "drive":
            scene = _drive(seed, number)[0]
            pose = scene.pose(index)
            x_m, y_m, _ = pose.position_m
            told = {"pose": {"x_m": x_m, "y_m": y_m, "yaw_rad": pose.yaw_rad}}
        else:
            scene = random_scene(seed, number)
    samples = Chirp.parse(chirp_name).samples(AUDIO_RATE_HZ)
    return scene.hear(index, DEFAULT_NUM_WORDS, samples), {**scene.truth(index), **told}
