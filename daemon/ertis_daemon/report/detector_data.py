"""The detector run over recordings whose truth is known."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ertis_daemon.labelled import recorded_truth, recordings_in
from ertis_daemon.pipeline import detector_of
from ertis_daemon.workers import Workers
from ertis_detector.air import Air
from ertis_detector.evaluate import DEFAULT_RATE_HZ, Evaluation, evaluate
from ertis_detector.matching import JudgedPing, TrueLandmark
from ertis_detector.model import Model, file_sha256, load_model, shipped_model
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.dataset import METADATA, DatasetRow, open_dataset
from ertis_driver.device import Settings
from ertis_driver.errors import RecordingError
from ertis_driver.recording import RecordedPing, RecordingInfo, open_recording

if TYPE_CHECKING:
    from ertis_driver.chirp import Emission

FLOOR = 0.05  # the curve over thresholds begins here; less probable reports are not looked at


@dataclass(frozen=True, slots=True)
class Source:
    """Pings to judge: a labelled data set's row, or a recording with truth in it."""

    path: Path
    row: DatasetRow | None = None


@dataclass(frozen=True, slots=True)
class Judged:
    """What became of one source, and who made it."""

    pings: tuple[JudgedPing, ...]
    made_by: str
    chirp: str


@dataclass(frozen=True, slots=True, eq=False)
class DetectorReport:
    """What came out, of what.

    data : name of each data set or recording, and its manifest or file hash
    model, model_source, model_data : as its card says
    """

    data: tuple[tuple[str, str], ...]
    sources: tuple[str, ...]
    chirps: tuple[str, ...]
    model: str
    model_source: str
    model_data: str
    evaluation: Evaluation

    @property
    def met_before(self) -> tuple[str, ...]:
        """Data that the model's card says it was trained on: nothing can be judged by them."""
        return tuple(
            name for name, digest in self.data if digest.split()[-1][:16] in self.model_data
        )


@dataclass(frozen=True)
class Judge:
    """Decodes pings, lets the detector look, and puts its reports beside the truth."""

    model: Path | None
    min_probability: float

    def __call__(self, source: Source) -> Judged:
        """Every ping of one source.

        Raises
        ------
        RecordingError, DetectorError
        """
        recording = open_recording(source.path)
        chirp = recording.info.chirp
        if chirp is None:
            raise RecordingError(
                f"{source.path} says no chirp, expected one: record it with its chirp"
            )
        judged = tuple(self._judge(source, recording.info, chirp, ping) for ping in recording)
        return Judged(judged, recording.info.source, chirp.name)

    def _judge(
        self, source: Source, info: RecordingInfo, chirp: Emission, ping: RecordedPing
    ) -> JudgedPing:
        landmarks = _truth(source, ping)
        detector = detector_of(
            model_for(self.model, chirp.name, self._models),
            Settings(chirp, info.num_words, pdm_rate_hz=info.pdm_rate_hz),
            Air.measured(ping.temperature_c, ping.humidity_percent),
            self.min_probability,
        )
        audio = self._decoder.decode(whole_samples(ping.frame.words)).audio
        detector.detect(audio)  # a detector just built is cold, one that runs is not
        begun = time.thread_time()  # of the processor: neighbours do not count
        found = detector.detect(audio)
        seconds = time.thread_time() - begun
        environment = source.row.environment if source.row else ""
        return JudgedPing(landmarks, tuple(found), seconds, _group(source, ping), environment)

    @cached_property
    def _decoder(self) -> PdmDecoder:
        return PdmDecoder()

    @cached_property
    def _models(self) -> dict[str, Model]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {"model": self.model, "min_probability": self.min_probability}


def model_for(path: Path | None, chirp: str, known: dict[str, Model]) -> Model:
    """The model named, or the one shipped for the chirp.

    Raises
    ------
    DetectorError
        If it cannot be read, or there is none for the chirp.
    """
    if chirp not in known:
        known[chirp] = load_model(shipped_model(chirp) if path is None else path)
    return known[chirp]


def judge(
    paths: Sequence[Path],
    model: Path | None = None,
    *,
    min_probability: float | None = None,
    rate_hz: float = DEFAULT_RATE_HZ,
    workers: int = 1,
    progress: Callable[[str, int, int], None] = lambda what, done, of: None,
) -> DetectorReport:
    """Run a detector over data sets and recordings, and judge it.

    Parameters
    ----------
    paths : folders of labelled data sets, or recordings with truth
    model : file; None for the one shipped for the recordings' chirp
    min_probability : float or None
        Reporting threshold; None for the model's own.
    rate_hz : float
        Pings a second that false alarms are told for.
    workers : int
        Processes.

    Raises
    ------
    DatasetError, RecordingError, DetectorError
    SettingsError
        If one is named twice: its pings would count twice.
    """
    sources, data = _sources(paths)
    first = open_recording(sources[0].path).info.chirp
    if first is None:
        raise RecordingError(f"{sources[0].path} says no chirp, expected one")
    used = model_for(model, first.name, {})
    threshold = used.card.min_probability if min_probability is None else min_probability
    reading = Workers(workers, lambda done, of: progress("recordings heard", done, of))
    judged = list(reading(Judge(model, min(FLOOR, threshold)), sources))
    chirps = tuple(sorted({one.chirp for one in judged}))
    if len(chirps) > 1:
        raise RecordingError(
            f"recordings with chirps {', '.join(chirps)}: judge one detector at a time"
        )
    return DetectorReport(
        data=tuple(data),
        sources=tuple(sorted({one.made_by for one in judged})),
        chirps=chirps,
        model=used.name,
        model_source=used.card.source,
        model_data=used.card.data,
        evaluation=evaluate(
            [ping for one in judged for ping in one.pings], threshold, rate_hz=rate_hz
        ),
    )


def _sources(paths: Sequence[Path]) -> tuple[list[Source], list[tuple[str, str]]]:
    sources = [Source(file, row) for file, row in recordings_in(paths)]
    return sources, [(str(path), _digest(path)) for path in paths]


def _digest(path: Path) -> str:
    """What names a data set or a recording by all that is in it."""
    if not path.is_dir():
        open_recording(path)
        return f"sha256 {file_sha256(path)}"
    dataset = open_dataset(path)
    if not dataset.rows:
        raise RecordingError(f"{dataset.folder / METADATA} has no row: record something first")
    return f"manifest {dataset.manifest_hash}"


def _group(source: Source, ping: RecordedPing) -> str:
    if source.row is not None:
        return f"{source.row.environment}/{source.row.session}"
    scene = (ping.truth or {}).get("scene", "")
    return f"{source.path} {scene}"


def _truth(source: Source, ping: RecordedPing) -> tuple[TrueLandmark, ...]:
    """What the recording says; a live one's row says where its label points."""
    row = source.row
    try:
        truth = recorded_truth(row, ping.truth)
        if truth is not None:
            return tuple(map(TrueLandmark.of, truth["landmarks"]))
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(
            f"{source.path}: ping {ping.frame.ping_index}: its truth lacks or garbles "
            f"a landmark's field: {error}"
        ) from error
    if row is None:
        raise RecordingError(
            f"{source.path}: ping {ping.frame.ping_index} has no truth: nothing to judge by"
        )
    if row.label == "none":
        return ()
    if math.isnan(row.range_m) or math.isnan(row.azimuth_rad):
        raise RecordingError(
            f"{source.path}: its label {row.label} has no range or no azimuth, expected both in "
            f"{METADATA}"
        )
    return (TrueLandmark(row.label, row.range_m, row.azimuth_rad, tilt_rad=abs(row.yaw_rad)),)
