"""Audio of one ping to candidates: every distinct strong echo, located, with its features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_detector.errors import DetectorError
from ertis_detector.features import EchoFeatures, Places, array_coherence
from ertis_detector.fragment import FRAGMENT_SAMPLES
from ertis_detector.imaging import (
    Complex,
    Energyscape,
    Float,
    Focus,
    Imager,
    MatchedFilter,
    plane,
    unit_vectors,
)
from ertis_detector.locate import Location, locate
from ertis_detector.proposals import Proposal, propose

MAX_PROPOSALS = 8  # a frame with eight must still fit into one ping period
MIN_SNR_DB = 12.0  # the noise's own highest peaks are 10 over its mean
NEAREST_M = 0.58  # nearer, only the emitter's ringing is heard
# From there on it fades into the noise: at first a candidate must stand out of it by so much more.
_RINGING_DB, _RINGING_UNTIL_M = 12.0, 0.76
# Further up or down the emitter's beam leaves nothing, but floor and ceiling.
MAX_ELEVATION_RAD = np.deg2rad(30.0)
OWN_ECHO_DB, OWN_ECHO_RANGE_M = 9.0, 0.25
SENSOR_BAND_HZ = (20e3, 90e3)  # beyond it transducer and microphones leave nothing of the chirp


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
    air : Air
        Speed of sound and absorption follow.
    """

    def __init__(
        self,
        *,
        mic_positions_m: Float,
        emitter_position_m: Float,
        chirp_samples: Float,
        chirp_band_hz: tuple[float, float],
        num_samples: int,
        air: Air,
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
        self._imager = Imager(mic_positions_m, info, air.speed_of_sound_m_s, *plane())
        nearness = (_RINGING_UNTIL_M - self._imager.range_m) / (_RINGING_UNTIL_M - NEAREST_M)
        self._ringing_db = _RINGING_DB * np.clip(nearness, 0, 1)
        self.focus = Focus(mic_positions_m, emitter_position_m, info, air.speed_of_sound_m_s)
        self._features = EchoFeatures(self._filter, chirp_samples, air)

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

    def candidates(
        self,
        baseband: Complex,
        scape: Energyscape,
        within_m: tuple[float, float] | None = None,
    ) -> list[Candidate]:
        """Every distinct strong echo of a ping, located, from what ``image`` returned.

        But for echoes of something else's: a strong reflector is heard in the array's sidelobes
        and by way of the floor, too.

        Parameters
        ----------
        within_m : (nearest, furthest) or None
            Ranges looked at; None for all from ``NEAREST_M``.
        """
        floor = scape.noise_floor
        proposals = propose(
            scape,
            max_count=MAX_PROPOSALS,
            min_snr_db=MIN_SNR_DB + self._ringing_db,
            within_m=within_m or (NEAREST_M, np.inf),
        )
        located = locate(self.focus, baseband, _without_own_echoes(proposals), MAX_ELEVATION_RAD)
        return [Candidate(at, float(10 * np.log10(max(at.power, floor) / floor))) for at in located]

    def features(
        self, baseband: Complex, candidates: Sequence[Candidate]
    ) -> npt.NDArray[np.float32]:
        """What the classifier sees of candidates, at least one; shape (n, NUM_FEATURES)."""
        locations = [candidate.location for candidate in candidates]
        places = Places(
            np.array([at.range_m for at in locations]),
            np.array([at.azimuth_rad for at in locations]),
            np.array([at.elevation_rad for at in locations]),
            np.array([candidate.snr_db for candidate in candidates]),
        )
        toward = unit_vectors(places.azimuth_rad, places.elevation_rad)
        points = places.range_m[:, None] * toward
        fragments = self.focus.beam(baseband, points, FRAGMENT_SAMPLES // 2, FRAGMENT_SAMPLES)
        coherence = array_coherence(self.focus, baseband, points)
        return self._features(fragments, coherence, places)


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
