"""A labelled data set on disk: one recording a ping, ``metadata.csv``, and who made it.

Every file appears whole or not at all: it is written beside its place and renamed. What is there
already is kept, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import json
import math
import shutil
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ertis_driver.chirp import Chirp
from ertis_driver.dataset import PART, DatasetRow, file_sha256, replace_file, write_table
from ertis_driver.errors import RecordingError
from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS, PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter, read_recording
from ertis_simulator.errors import SceneError
from ertis_simulator.paper_dataset import NONE, VARIANTS, PlannedPing, build_scene, plan

GENERATOR = 3  # raised when the same seed comes to mean other files
MANIFEST = "dataset.json"
OPERATOR = "simulated"
PING_BYTES = 4 * DEFAULT_NUM_WORDS + 16_384  # of a file, truth and all
WEAK_DB = 0.0  # below it, a landmark's own echo is not the strongest thing in its fragment
_PERIOD_NS = 100_000_000  # no clock ran: 10 pings a second from the epoch, for reproducible files


@dataclass(frozen=True, slots=True)
class DatasetSpec:
    """What a data set is made of; the same spec makes the same bytes.

    seed : int
    num_pings : int
    variant : str
        One of ``VARIANTS``.
    chirp : str
        As ``Chirp.parse`` takes it.
    """

    seed: int
    num_pings: int
    variant: str
    chirp: str

    def manifest(self) -> str:
        """What ``dataset.json`` says."""
        said = {
            "source": "sim",
            "generator": GENERATOR,
            "seed": self.seed,
            "num_pings": self.num_pings,
            "variant": self.variant,
            "about": VARIANTS[self.variant].about,
            "chirp": self.chirp,
        }
        return json.dumps(said, indent=2) + "\n"


def make_dataset(
    folder: Path,
    spec: DatasetSpec,
    workers: int,
    progress: Callable[[int], None] = lambda done: None,
) -> int:
    """Make or complete a data set; returns how many pings were made now.

    Parameters
    ----------
    folder
        New, empty, or begun with the same spec.
    workers : int
        Processes.
    progress
        Called with the number of pings that are there.

    Raises
    ------
    SceneError
        If the folder holds something else.
    RecordingError, DatasetError
        If a file cannot be written or read; a full disk is named before the work begins.
    """
    pings = plan(spec.num_pings)
    try:
        _prepare(folder, spec, pings)
    except OSError as error:
        raise _failed(error.filename or folder, error) from error
    jobs = [(str(folder), spec, ping) for ping in pings]
    rows, made = [], 0
    with get_context("spawn").Pool(workers, _leave_interrupts_to_the_parent) as pool:
        for row, is_new in pool.imap(_make, jobs, chunksize=2):
            rows.append(row)
            made += is_new
            progress(len(rows))
    write_table(folder, rows)
    return made


def _prepare(folder: Path, spec: DatasetSpec, pings: Sequence[PlannedPing]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    manifest = folder / MANIFEST
    if manifest.exists():
        if manifest.read_bytes() != spec.manifest().encode():
            raise SceneError(
                f"{manifest} tells of another data set than {spec}: name another folder, or give "
                "the seed, size, variant and chirp it was begun with"
            )
    elif any(folder.iterdir()):
        raise SceneError(f"{folder} is not empty and no data set: name a new folder")
    for ping in pings:
        path = folder / ping.file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        _part_of(path).unlink(missing_ok=True)
    missing = sum(not (folder / ping.file_name).exists() for ping in pings)
    free, needed = shutil.disk_usage(folder).free, missing * PING_BYTES
    if free < needed:
        raise RecordingError(
            f"{folder}: {free / 1e6:.0f} MB free, expected {needed / 1e6:.0f} MB for {missing} "
            "pings: free some, or make fewer with -n"
        )
    replace_file(manifest, spec.manifest().encode())


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _make(job: tuple[str, DatasetSpec, PlannedPing]) -> tuple[DatasetRow, bool]:
    """Make one file if it is not there; its row of the table. Runs in a worker process."""
    folder, spec, ping = job
    path = Path(folder) / ping.file_name
    is_new = not path.exists()
    if is_new:
        _record(path, spec, ping)
    truth = next(iter(read_recording(path))).truth or {}
    return _row(path, ping, truth), is_new


def _record(path: Path, spec: DatasetSpec, ping: PlannedPing) -> None:
    labelled = build_scene(spec.seed, ping, VARIANTS[spec.variant])
    chirp = Chirp.parse(spec.chirp)
    words, truth = labelled.scene.hear_and_judge(
        ping.number, DEFAULT_NUM_WORDS, chirp.samples(AUDIO_RATE_HZ)
    )
    yaw_deg = math.degrees(labelled.yaw_rad)
    truth["label"] = {
        "label": ping.label,
        "range_m": round(labelled.range_m, 4),
        "azimuth_deg": round(math.degrees(labelled.azimuth_rad), 2),
        "yaw_deg": None if math.isnan(yaw_deg) else round(yaw_deg, 2),
        "environment": ping.environment,
        "session": ping.session_name,
    }
    truth["dead_microphones"] = list(labelled.scene.dead_mics)
    address = f"data set {spec.variant}, seed {spec.seed}"
    air = labelled.scene.air
    info = RecordingInfo(
        "sim",
        chirp,
        DEFAULT_NUM_WORDS,
        round(air.temperature_c, 2),
        round(air.humidity_percent, 1),
        address=address,
    )
    part = _part_of(path)
    part.unlink(missing_ok=True)
    try:
        with RecordingWriter(part, info) as writer:
            writer.write(PdmFrame(words, ping.number, ping.number * _PERIOD_NS), truth)
        part.replace(path)
    except OSError as error:
        raise _failed(path, error) from error
    finally:
        part.unlink(missing_ok=True)


def _row(path: Path, ping: PlannedPing, truth: dict[str, Any]) -> DatasetRow:
    said = truth["label"]
    yaw_deg = said["yaw_deg"]
    return DatasetRow(
        file_name=ping.file_name,
        label=said["label"],
        range_m=said["range_m"],
        azimuth_rad=math.radians(said["azimuth_deg"]),
        yaw_rad=math.nan if yaw_deg is None else math.radians(yaw_deg),
        environment=said["environment"],
        session=said["session"],
        operator=OPERATOR,
        sha256=file_sha256(path),
        quality=_quality(truth),
    )


def _quality(truth: dict[str, Any]) -> str:
    """``good``; ``weak`` or ``shadowed`` of the labelled landmark, which comes first in truth."""
    if truth["label"]["label"] == NONE:
        return "good"
    first = truth["landmarks"][0]
    if first["shadowed"]:
        return "shadowed"
    ratio_db = first["own_to_rest_db"]
    return "weak" if ratio_db is None or ratio_db < WEAK_DB else "good"


def _part_of(path: Path) -> Path:
    return path.with_name(path.name + PART)


def _failed(path: object, error: OSError) -> RecordingError:
    return RecordingError(f"cannot write {path}: {error.strerror}")
