"""``ertis simulate``: recordings of simulated scenes, with truth."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from ertis_driver.chirp import Chirp


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("scene", nargs="?", type=Path, help="YAML scene to play")
    what.add_argument(
        "--random", action="store_true", help="a new random scene for each ping, to train on"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, help="MCAP file to make")
    parser.add_argument("-n", "--pings", type=int, default=10, metavar="N", help="default 10")
    parser.add_argument("--seed", type=int, default=1, help="of the random scenes, default 1")
    parser.add_argument(
        "--chirp", metavar="KIND:START:STOP:SECONDS", help="default hyperbolic:80000:20000:0.0025"
    )


def run(args: argparse.Namespace) -> int:
    """Make the recording on all cores."""
    from multiprocessing import get_context

    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.errors import SettingsError
    from ertis_driver.frame import DEFAULT_NUM_WORDS, PdmFrame
    from ertis_driver.recording import RecordingInfo, RecordingWriter

    if args.pings < 1:
        raise SettingsError(f"--pings {args.pings}, expected 1 or more")
    chirp = Chirp.parse(args.chirp) if args.chirp else DEFAULT_CHIRP
    jobs = _jobs(args, chirp)
    info = RecordingInfo("sim", chirp, DEFAULT_NUM_WORDS, address=_address(args))
    with (
        RecordingWriter(args.output, info) as writer,
        get_context("spawn").Pool(os.cpu_count()) as pool,
    ):
        for index, (words, truth) in enumerate(pool.imap(_hear, jobs, chunksize=4)):
            # No clock ran: 10 pings a second from the epoch, so that the file is reproducible.
            frame = PdmFrame(words, index, index * 100_000_000)
            writer.write(frame, truth, temperature_c=truth["temperature_c"])
            if sys.stderr.isatty():
                print(f"\rsimulated {index + 1}/{args.pings}", end="", file=sys.stderr)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return 0


def _address(args: argparse.Namespace) -> str:
    return f"random seed {args.seed}" if args.random else f"sim:{args.scene.name}"


def _jobs(args: argparse.Namespace, chirp: Chirp) -> list[tuple[Any, int, str]]:
    from ertis_simulator.scene_file import load_scene

    if args.random:
        return [((args.seed, index), 0, chirp.name) for index in range(args.pings)]
    scene = load_scene(args.scene)
    return [(scene, index, chirp.name) for index in range(args.pings)]


def _hear(job: tuple[Any, int, str]) -> tuple[npt.NDArray[np.uint32], dict[str, Any]]:
    """Words and truth of one ping; runs in a worker process."""
    from ertis_driver.chirp import Chirp
    from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS
    from ertis_simulator.dataset import random_scene

    scene, index, chirp_name = job
    if isinstance(scene, tuple):
        scene = random_scene(*scene)
    samples = Chirp.parse(chirp_name).samples(AUDIO_RATE_HZ)
    return scene.hear(index, DEFAULT_NUM_WORDS, samples), scene.truth(index)
