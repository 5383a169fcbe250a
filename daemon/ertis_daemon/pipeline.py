"""A frame in, tracks out: what the service runs on each ping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ertis_daemon.config import Config
from ertis_detector.detection import Detection
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.device import Settings
from ertis_driver.errors import SettingsError
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION, NUM_MICS, PDM_RATE_HZ, PdmFrame

if TYPE_CHECKING:
    from ertis_detector.detector import LandmarkDetector
    from ertis_detector.scanner import Scanner
    from ertis_detector.tracker import Tracker

NOMINAL_TEMPERATURE_C = 20.0
_TEMPERATURE_STEP_C = 0.1  # 0.06 m/s: under 1 mm of any range


class TrackLike(Protocol):
    """One landmark followed over pings; ``state`` is new, update or lost."""

    @property
    def track_id(self) -> int:
        """The same number as long as it is followed."""

    @property
    def state(self) -> str:
        """``new``, ``update`` or ``lost``."""

    @property
    def detection(self) -> Detection:
        """The last of it that was heard."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What one ping told."""

    tracks: Sequence[TrackLike]
    half_words_repaired: int = 0


class Pipeline(Protocol):
    """What the service needs of a pipeline."""

    @property
    def model_name(self) -> str:
        """Name of the classifier's model."""

    @property
    def classes(self) -> Sequence[str]:
        """What it can tell apart."""

    def process(self, frame: PdmFrame) -> Heard:
        """Tracks after this ping.

        Raises
        ------
        Exception
            Whatever a bad frame causes; the service drops the ping.
        """


class DetectorPipeline:
    """Decode, detect, track."""

    def __init__(
        self,
        decoder: PdmDecoder,
        detector: LandmarkDetector,
        tracker: Tracker,
        *,
        model_name: str,
        classes: Sequence[str],
    ) -> None:
        self._decoder = decoder
        self._detector = detector
        self._tracker = tracker
        self._audio = np.empty((NUM_MICS, 0), np.float32)  # every ping's: fresh memory is slow
        self.model_name = model_name
        self.classes = classes

    def process(self, frame: PdmFrame) -> Heard:
        """Tracks after this ping."""
        words = whole_samples(frame.words)
        if self._audio.shape[1] != words.size // DECIMATION:
            # Rows a power of two apart would compete for the same lines of the cache.
            num_samples = words.size // DECIMATION
            self._audio = np.empty((NUM_MICS, num_samples + 16), np.float32)[:, :num_samples]
        decoded = self._decoder.decode(words, self._audio)
        detections = self._detector.detect(decoded.audio)
        tracks = self._tracker.update(detections, frame.ping_time_ns)
        return Heard(tracks, decoded.half_words_repaired)


def build_pipeline(config: Config, settings: Settings) -> DetectorPipeline:
    """Build the pipeline that fits a configuration.

    Parameters
    ----------
    config
        For the model, the least probability and the air.
    settings
        What the sonar is set to; for a recording that is what it was recorded with.

    Raises
    ------
    DetectorError
        If the model cannot be read or does not fit the chirp.
    """
    from ertis_detector.tracker import Tracker

    detector = build_detector(
        settings, config.temperature_c, config.detector.model, config.detector.min_probability
    )
    model = detector.model
    return DetectorPipeline(
        PdmDecoder(), detector, Tracker(), model_name=model.name, classes=tuple(model.classes)
    )


def build_detector(
    settings: Settings, temperature_c: float, model_path: str = "", min_probability: float = 0.0
) -> LandmarkDetector:
    """Build the detector for what an eRTIS is set to, in air of a temperature.

    Parameters
    ----------
    model_path : str
        The shipped model for the chirp if empty.
    min_probability : float
        The model's own if 0.

    Raises
    ------
    DetectorError
        If the model cannot be read or does not fit the chirp.
    """
    from ertis_detector.detector import LandmarkDetector
    from ertis_detector.model import load_model, shipped_model
    from ertis_driver.audio_filter import FILTER_VERSION

    chirp = settings.chirp.name
    return LandmarkDetector(
        load_model(Path(model_path) if model_path else shipped_model(chirp)),
        build_scanner(settings, temperature_c),
        chirp=chirp,
        audio_filter=FILTER_VERSION,
        min_probability=min_probability or None,
    )


def build_scanner(settings: Settings, temperature_c: float) -> Scanner:
    """Build the scanner for what an eRTIS is set to, in air of a temperature.

    Raises
    ------
    DetectorError
        If the chirp or the listening time leaves nothing to detect.
    SettingsError
        If the PDM clock is not the one that the detector's audio is made from.
    """
    from ertis_detector.scanner import Scanner
    from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m

    if settings.pdm_rate_hz != PDM_RATE_HZ:
        raise SettingsError(
            f"PDM clock {settings.pdm_rate_hz} Hz: detection needs {PDM_RATE_HZ}; set it so, or "
            "record again"
        )
    chirp = settings.chirp
    return Scanner(
        mic_positions_m=mic_positions_m(),
        emitter_position_m=np.array(EMITTER_POSITION_M),
        chirp_samples=chirp.samples(AUDIO_RATE_HZ),
        chirp_band_hz=chirp.band_hz,
        num_samples=settings.num_words // DECIMATION,
        temperature_c=temperature_c,
    )


def rounded_temperature_c(temperature_c: float | None) -> float:
    """To a tenth, so that one scanner serves many pings; 20 if nobody measured it."""
    met = NOMINAL_TEMPERATURE_C if temperature_c is None else temperature_c
    return round(met / _TEMPERATURE_STEP_C) * _TEMPERATURE_STEP_C
