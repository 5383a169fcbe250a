"""A frame in, tracks out: what the service runs on each ping."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ertis_daemon.config import SonarConfig
from ertis_detector.air import Air
from ertis_detector.detection import Detection
from ertis_driver.audio import DecodedAudio, PdmDecoder, whole_samples
from ertis_driver.device import Settings
from ertis_driver.errors import SettingsError
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION, NUM_MICS, PDM_RATE_HZ, PdmFrame

if TYPE_CHECKING:
    from ertis_daemon.odometry import Odometry
    from ertis_detector.detector import LandmarkDetector
    from ertis_detector.model import Model
    from ertis_detector.scanner import Scanner
    from ertis_detector.tracker import Tracker

# 0.06 and 0.05 m/s, at 40 degrees: under 1 mm of any range.
_TEMPERATURE_STEP_C, _HUMIDITY_STEP_PERCENT = 0.1, 0.5


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
        """What all its pings tell."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What one ping told.

    odometry_garbled : int
        Poses that could not be read since the ping before.
    without_odometry : bool
        Odometry was asked for, and did not tell where this ping was.
    """

    tracks: Sequence[TrackLike]
    half_words_repaired: int = 0
    odometry_garbled: int = 0
    without_odometry: bool = False
    decoded: DecodedAudio | None = None  # until the next ping: its memory is used again


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
        odometry: Odometry | None = None,
    ) -> None:
        self._odometry = odometry
        self._decoder = decoder
        self._detector = detector
        self._tracker = tracker
        self._audio = np.empty((NUM_MICS, 0), np.float32)  # every ping's: fresh memory is slow
        self._steps_ns = 0
        self.model_name = model_name
        self.classes = classes

    def process(self, frame: PdmFrame) -> Heard:
        """Tracks after this ping."""
        # For the tracker time goes on as it did, whatever the host's clock is set to, and whether
        # or not this ping can be processed.
        self._steps_ns += frame.clock_step_ns
        words = whole_samples(frame.words)
        if self._audio.shape[1] != words.size // DECIMATION:
            # Rows a power of two apart would compete for the same lines of the cache.
            num_samples = words.size // DECIMATION
            self._audio = np.empty((NUM_MICS, num_samples + 16), np.float32)[:, :num_samples]
        decoded = self._decoder.decode(words, self._audio)
        detections = self._detector.detect(decoded.audio)
        told = self._odometry.at_ping(frame.ping_time_ns) if self._odometry else None
        time_ns = frame.ping_time_ns - self._steps_ns
        tracks = self._tracker.update(detections, time_ns, told.motion if told else None)
        return Heard(
            tracks,
            decoded.half_words_repaired,
            odometry_garbled=told.garbled if told else 0,
            without_odometry=told is not None and not told.is_known,
            decoded=decoded,
        )


def build_pipeline(
    config: SonarConfig,
    settings: Settings,
    odometry: Odometry | None = None,
    detector: LandmarkDetector | None = None,
) -> DetectorPipeline:
    """Build the pipeline that fits a configuration.

    Parameters
    ----------
    config
        For the model, the least probability, the tracker and the air.
    settings
        What the sonar is set to; for a recording that is what it was recorded with.
    odometry
        What tells how the sonar moved.
    detector
        What ``detector_for`` made of the same; made now if there is none.

    Raises
    ------
    DetectorError
        If the model cannot be read or does not fit the chirp.
    """
    detector = detector or detector_for(config, settings)
    model = detector.model
    return DetectorPipeline(
        PdmDecoder(),
        detector,
        build_tracker(config, settings, model.card.tracking),
        model_name=model.name,
        classes=tuple(model.classes),
        odometry=odometry,
    )


def detector_for(config: SonarConfig, settings: Settings) -> LandmarkDetector:
    """Build the detector that feeds a tracker: it reports what is improbable, too.

    Raises
    ------
    DetectorError
        If the model cannot be read or does not fit the chirp.
    """
    from ertis_detector.model import FOLLOWING_PROBABILITY

    least = min(config.detector.min_probability or 1.0, FOLLOWING_PROBABILITY)
    return build_detector(settings, config.air, config.detector.model, least)


def build_tracker(config: SonarConfig, settings: Settings, figures: Mapping[str, float]) -> Tracker:
    """Build the tracker for a configuration and the figures on a model's card."""
    from ertis_detector.model import TRACKING_PROBABILITY
    from ertis_detector.rates import DetectorRates
    from ertis_detector.tracker import Tracker, TrackerSettings

    own = config.tracker
    asked = TrackerSettings(
        max_false_events_per_hour=own.max_false_events_per_hour,
        landmarks_per_hour=own.landmarks_per_hour,
        ping_rate_hz=config.ping_rate_hz or 1.0 / settings.listening_s,
        max_speed_m_s=own.max_speed_m_s,
        max_turn_rad_s=math.radians(own.max_turn_deg_s),
        max_silence_s=own.max_silence_s,
        max_unheard_s=own.max_unheard_s,
        start_probability=config.detector.min_probability or TRACKING_PROBABILITY,
    )
    return Tracker(DetectorRates.from_figures(figures), asked)


def build_detector(
    settings: Settings, air: Air, model_path: str = "", min_probability: float = 0.0
) -> LandmarkDetector:
    """Build the detector for what an eRTIS is set to, in this air.

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
    from ertis_detector.model import load_model, shipped_model

    model = load_model(Path(model_path) if model_path else shipped_model(settings.chirp.name))
    return detector_of(model, settings, air, min_probability)


def detector_of(
    model: Model, settings: Settings, air: Air, min_probability: float = 0.0
) -> LandmarkDetector:
    """As ``build_detector``, with a model that is loaded already."""
    from ertis_detector.detector import LandmarkDetector
    from ertis_driver.audio_filter import FILTER_VERSION

    return LandmarkDetector(
        model,
        build_scanner(settings, air),
        chirp=settings.chirp.name,
        audio_filter=FILTER_VERSION,
        min_probability=min_probability or None,
    )


def build_scanner(settings: Settings, air: Air) -> Scanner:
    """Build the scanner for what an eRTIS is set to, in this air.

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
        air=air,
    )


def rounded(air: Air) -> Air:
    """To a tenth of a degree and half a percent, so that one scanner serves many pings."""
    degrees = round(air.temperature_c / _TEMPERATURE_STEP_C) * _TEMPERATURE_STEP_C
    percent = round(air.humidity_percent / _HUMIDITY_STEP_PERCENT) * _HUMIDITY_STEP_PERCENT
    return Air(degrees, percent)
