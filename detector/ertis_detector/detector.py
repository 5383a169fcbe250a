"""Audio of one ping to detections: scan, propose, locate, classify."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import NONE, UNKNOWN, Detection, radius_m
from ertis_detector.errors import DetectorError
from ertis_detector.features import features
from ertis_detector.fragment import FRAGMENT_SAMPLES
from ertis_detector.imaging import Complex, Energyscape, Float, Focus, Imager, MatchedFilter, plane
from ertis_detector.locate import Location, locate
from ertis_detector.model import Model
from ertis_detector.proposals import Proposal, propose

MAX_PROPOSALS = 8  # a frame with eight must still fit into one ping period
MIN_SNR_DB = 14.0
# Beyond the first null of the emitter's beam a spectrum says more of the beam than of the dish, and
# a landmark hangs about as high as the sonar: what lies far above or below is floor and ceiling.
MAX_AZIMUTH_RAD, MAX_ELEVATION_RAD = np.deg2rad(30.0), np.deg2rad(12.0)
OWN_ECHO_DB, OWN_ECHO_RANGE_M = 5.0, 0.25  # nearer to a dish nothing was trained
MAX_RANGE_M = 4.6  # models are trained on landmarks up to 4.5 m
SENSOR_BAND_HZ = (20e3, 90e3)  # beyond it transducer and microphones leave nothing of the chirp
# The two-bounce ring, not the vertex, is the peak: (sqrt(2) - 1) R behind it, R = 1.1333 a.
RING_OFFSET = (np.sqrt(2) - 1) * 1.1333
# One sigma that stays at any signal level, from the pattern of rings and rounding: assumed until
# the evaluation measures it.
_RANGE_SIGMA_M, _AZIMUTH_SIGMA_RAD, _ELEVATION_SIGMA_RAD = 6e-3, np.deg2rad(0.7), np.deg2rad(2.0)
_BEAM_RAD = np.deg2rad((6.5, 12.0))


@dataclass(frozen=True, slots=True)
class Candidate:
    """A located proposal, before classification; level over the noise floor, dB."""

    location: Location
    snr_db: float


class Scanner:
    """What is the same for every ping of one device: filter, directions, steering.

    Parameters
    ----------
    mic_positions_m : shape (num_mics, 3)
    emitter_position_m : shape (3,)
    chirp_samples : float64, shape (n,)
        The emitted sweep at 450 kHz.
    chirp_band_hz : (low, high)
        Its lowest and highest frequency.
    num_samples : int
        Audio samples a ping.
    speed_of_sound_m_s : float
    """

    def __init__(
        self,
        *,
        mic_positions_m: Float,
        emitter_position_m: Float,
        chirp_samples: Float,
        chirp_band_hz: tuple[float, float],
        num_samples: int,
        speed_of_sound_m_s: float,
    ) -> None:
        band = max(chirp_band_hz[0], SENSOR_BAND_HZ[0]), min(chirp_band_hz[1], SENSOR_BAND_HZ[1])
        if band[1] - band[0] < 5e3:
            raise DetectorError(
                f"chirp of {chirp_band_hz[0]:g} to {chirp_band_hz[1]:g} Hz leaves less than 5 kHz "
                f"of the sensor's {SENSOR_BAND_HZ[0]:g} to {SENSOR_BAND_HZ[1]:g} Hz: widen it"
            )
        if num_samples < 4 * chirp_samples.size:
            raise DetectorError(
                f"{num_samples} audio samples a ping, expected at least four times the chirp's "
                f"{chirp_samples.size}: listen for longer"
            )
        self.num_samples = num_samples
        self._filter = MatchedFilter(chirp_samples, num_samples, band)
        info = self._filter.baseband
        self._imager = Imager(mic_positions_m, info, speed_of_sound_m_s, *plane())
        self.focus = Focus(mic_positions_m, emitter_position_m, info, speed_of_sound_m_s)

    def image(self, audio: npt.NDArray[np.float32]) -> tuple[Complex, Energyscape]:
        """Compressed baseband and energyscape of one ping.

        Raises
        ------
        DetectorError
            If the audio has another length or number of microphones.
        """
        expected = (len(self.focus.mics), self.num_samples)
        if audio.shape != expected:
            raise DetectorError(f"audio of shape {audio.shape}, expected {expected}")
        baseband = self._filter(audio)
        return baseband, self._imager(baseband)

    def candidates(self, audio: npt.NDArray[np.float32]) -> tuple[Complex, list[Candidate]]:
        """The compressed baseband of one ping, and every distinct strong echo in it, located.

        But for echoes of something else's: a strong reflector is heard in the array's sidelobes
        and by way of the floor, too.
        """
        baseband, scape = self.image(audio)
        floor = scape.noise_floor
        proposals = propose(
            scape,
            max_count=MAX_PROPOSALS,
            min_snr_db=MIN_SNR_DB,
            max_azimuth_rad=MAX_AZIMUTH_RAD,
        )
        return baseband, [
            Candidate(at, float(10 * np.log10(max(at.power, floor) / floor)))
            for at in locate(
                self.focus, baseband, _without_own_echoes(proposals), MAX_ELEVATION_RAD
            )
            if abs(at.azimuth_rad) <= MAX_AZIMUTH_RAD and at.range_m <= MAX_RANGE_M
        ]

    def features(
        self, baseband: Complex, candidates: Sequence[Candidate]
    ) -> npt.NDArray[np.float32]:
        """What the classifier sees of candidates, at least one; shape (n, NUM_FEATURES)."""
        places = [candidate.location for candidate in candidates]
        points = np.stack([at.point_m for at in places])
        fragments = self.focus.beam(baseband, points, FRAGMENT_SAMPLES // 2, FRAGMENT_SAMPLES)
        return features(
            fragments,
            self.focus.info.carrier_hz,
            np.array([at.range_m for at in places]),
            np.array([at.azimuth_rad for at in places]),
            np.array([at.elevation_rad for at in places]),
        )


class LandmarkDetector:
    """Says which landmark is where.

    Parameters
    ----------
    model : Model
    scanner : Scanner
    chirp, audio_filter : str
        What the device emits and how its sound was decimated; they must be the model's.
    min_probability : float
        Reported is what is a landmark, of whichever size, with this probability at least; None
        for the model's own.

    Raises
    ------
    ModelMismatch
    """

    def __init__(
        self,
        model: Model,
        scanner: Scanner,
        *,
        chirp: str,
        audio_filter: str,
        min_probability: float | None = None,
    ) -> None:
        model.check(chirp=chirp, audio_filter=audio_filter)
        self.model, self.scanner = model, scanner
        own = model.card.min_probability
        self.min_probability = own if min_probability is None else min_probability

    def detect(self, audio: npt.NDArray[np.float32]) -> list[Detection]:
        """Landmarks in one ping, most probable first.

        Parameters
        ----------
        audio : float32, shape (num_mics, num_samples)
            450 kHz.
        """
        baseband, candidates = self.scanner.candidates(audio)
        if not candidates:
            return []
        seen = self.scanner.features(baseband, candidates)
        rows = self.model.classifier.probabilities(seen)
        found = []
        for candidate, row in zip(candidates, rows, strict=True):
            told = {name: float(p) for name, p in zip(self.model.classes, row, strict=True)}
            told.setdefault(UNKNOWN, 0.0)
            landmarks = {name: p for name, p in told.items() if name not in (NONE, UNKNOWN)}
            if sum(landmarks.values()) >= self.min_probability:
                label = max(landmarks, key=lambda name: landmarks[name])
                found.append(_detection(candidate, label, told))
        return sorted(found, key=lambda one: -one.probabilities[one.label])


def _without_own_echoes(proposals: list[Proposal]) -> list[Proposal]:
    """Leave out what is much weaker than another proposal from the same range."""
    return [
        one
        for one in proposals
        if not any(
            other.snr_db > one.snr_db + OWN_ECHO_DB
            and abs(other.range_m - one.range_m) < OWN_ECHO_RANGE_M
            for other in proposals
        )
    ]


def _detection(candidate: Candidate, label: str, told: dict[str, float]) -> Detection:
    at = candidate.location
    vertex_range_m = at.range_m - RING_OFFSET * (radius_m(label) or 0.0)
    jitter = 0.5 / np.sqrt(2 * 10 ** (candidate.snr_db / 10))  # of a beamwidth, Gaussian beam
    variances = (
        _RANGE_SIGMA_M**2,
        _AZIMUTH_SIGMA_RAD**2 + (_BEAM_RAD[0] * jitter) ** 2,
        _ELEVATION_SIGMA_RAD**2 + (_BEAM_RAD[1] * jitter) ** 2,
    )
    covariance = tuple(
        tuple(float(v) if i == j else 0.0 for j in range(3)) for i, v in enumerate(variances)
    )
    return Detection(
        label,
        told,
        float(vertex_range_m),
        at.azimuth_rad,
        at.elevation_rad,
        covariance,  # type: ignore[arg-type]  # three by three, as built above
        candidate.snr_db,
    )
