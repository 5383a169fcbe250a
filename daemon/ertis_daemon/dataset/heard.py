"""What the recordings of a data set hold, read and judged on all cores."""

from __future__ import annotations

import hashlib
import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

from ertis_daemon.dataset.judge import Judge
from ertis_daemon.dataset.label import Label
from ertis_driver.chirp import Emission
from ertis_driver.dataset import DatasetRow, file_sha256, path_in_dataset
from ertis_driver.errors import DatasetError, RecordingError
from ertis_driver.recording import read_recording

USUAL_TEMPERATURE_C = 20.0


@dataclass(frozen=True, slots=True)
class Heard:
    """One row's recording.

    problem, problem_kind : str
        Why it cannot be used, or not be trusted; empty if it can.
    words_sha256 : str
        Of what the microphones heard; empty if it cannot be read.
    recorded_label : str
        What was said when it was recorded; empty if nothing was.
    ping_time_ns : int
    source : str
    settings : str
        Chirp and length.
    notes : dict
        What ``Judge`` finds, by its words.
    """

    problem: str = ""
    problem_kind: str = ""
    words_sha256: str = ""
    recorded_label: str = ""
    ping_time_ns: int = 0
    source: str = ""
    settings: str = ""
    notes: dict[str, str] = field(default_factory=dict)


def hear_all(
    folder: Path,
    rows: Sequence[DatasetRow],
    workers: int,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Heard]:
    """Read and judge the recordings of ``rows``, in their order.

    Parameters
    ----------
    workers : int
        Processes; 1 does it in this one.
    progress
        Called with the number of those done.
    """
    jobs = [(folder, row) for row in rows]
    heard = []
    if workers == 1:
        for job in jobs:
            heard.append(_hear(job))
            progress(len(heard))
        return heard
    with get_context("spawn").Pool(workers, signal.signal, (signal.SIGINT, signal.SIG_IGN)) as pool:
        for one in pool.imap(_hear, jobs, chunksize=4):
            heard.append(one)
            progress(len(heard))
    return heard


def _hear(job: tuple[Path, DatasetRow]) -> Heard:
    folder, row = job
    try:
        path = path_in_dataset(folder, row.file_name)
        if not path.exists():
            return Heard("is missing: restore it, or remove its row", "missing")
        sha256 = file_sha256(path)
        recording = read_recording(path)
        pings = list(recording)
    except (DatasetError, RecordingError) as error:
        return Heard(str(error), "unreadable")
    if len(pings) != 1:
        return Heard(f"holds {len(pings)} pings, expected one", "unreadable")
    info, ping = recording.info, pings[0]
    changed = bool(row.sha256) and sha256 != row.sha256
    label = (ping.truth or {}).get("label")
    said = label.get("label") if isinstance(label, dict) else None
    temperature_c = USUAL_TEMPERATURE_C if ping.temperature_c is None else ping.temperature_c
    notes: dict[str, str] = {}
    problem, kind = (
        ("changed since it was recorded: sha256 differs", "hash") if changed else ("", "")
    )
    if info.chirp is None:
        problem, kind = "no chirp is told: echoes cannot be checked", "unreadable"
    else:
        claimed = Label(row.label, row.range_m, row.azimuth_rad, row.yaw_rad)
        try:
            judge = _judge(info.chirp, info.num_words)
            notes = judge.judge(ping.frame, claimed, temperature_c).notes
        except ValueError as error:
            problem, kind = str(error), "unreadable"
    return Heard(
        problem=problem,
        problem_kind=kind,
        words_sha256=hashlib.sha256(ping.frame.words.tobytes()).hexdigest(),
        recorded_label=str(said or ""),
        ping_time_ns=ping.frame.ping_time_ns,
        source=info.source,
        settings=f"{info.chirp.name if info.chirp else 'no chirp'}, {info.num_words} words",
        notes=notes,
    )


def _judge(chirp: Emission, num_words: int) -> Judge:
    key = f"{chirp.name} {chirp.dac_codes().tobytes()!r} {num_words}"
    if key not in _judges:
        _judges.clear()  # a data set has one chirp, unless it is mixed up
        _judges[key] = Judge(chirp, num_words)
    return _judges[key]


_judges: dict[str, Judge] = {}  # a worker's own
