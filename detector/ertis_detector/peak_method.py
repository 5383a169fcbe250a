"""The baseline in the comparison: told the range of a ping, which landmark is there, if any."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_detector.deconvolution import REGULARISATION, Deconvolution, Table
from ertis_detector.detection import NONE, radius_m
from ertis_detector.imaging import AUDIO_RATE_HZ
from ertis_detector.peak_finding import Peaks, find_peaks
from ertis_detector.peak_likelihood import (
    PatternLikelihood,
    PeakStatistics,
    fitted_statistics,
    log_evidence,
)
from ertis_detector.peaks import FRAGMENT_SAMPLES

Float = npt.NDArray[np.float64]

BEAM = "beam"
_NOMINAL = Air()  # times are told as if in this
_SEARCHED_RAD = np.arcsin(np.linspace(-0.5, 0.5, 41))  # half a beam apart
_THRESHOLD_ROWS = 300  # enough for one number


class HeardPing(Protocol):
    """A ping and the range that is told; see ``KnownRangePing``."""

    @property
    def audio(self) -> npt.NDArray[np.float32]:
        """Shape (num_mics, num_samples), 450 kHz."""

    @property
    def range_m(self) -> float:
        """Of the landmark's deepest point."""

    @property
    def azimuth_rad(self) -> float:
        """NaN: the loudest direction is taken."""

    @property
    def air(self) -> Air:
        """The sound's."""

    @property
    def chirp(self) -> Float:
        """At 450 kHz."""

    @property
    def chirp_band_hz(self) -> tuple[float, float]:
        """Low, high."""

    @property
    def mic_positions_m(self) -> Float:
        """Shape (num_mics, 3)."""

    @property
    def emitter_position_m(self) -> Float:
        """Shape (3,)."""


class PeakMethod:
    """Peak patterns with levels, clutter and the odds of none learnt from labelled pings.

    Parameters
    ----------
    microphone : ``beam`` or an index
        The beam of all toward the direction, or one microphone.
    sensor, regularisation
        As of ``Deconvolution``.
    statistics : PeakStatistics
        What is not learnt.
    name : str
    """

    def __init__(
        self,
        microphone: str | int = BEAM,
        *,
        sensor: Table | None = None,
        regularisation: float = REGULARISATION,
        statistics: PeakStatistics | None = None,
        name: str = "peak pattern (Simon et al.)",
    ) -> None:
        if microphone != BEAM and not isinstance(microphone, int):
            raise ValueError(f"microphone {microphone!r}, expected {BEAM!r} or an index")
        self.name, self.microphone = name, microphone
        self.sensor, self.regularisation = sensor, regularisation
        self.statistics = statistics or PeakStatistics()
        self.classes: tuple[str, ...] = ()
        self.likelihood: PatternLikelihood | None = None
        self.log_odds_of_none = 0.0

    def prepare(self, ping: HeardPing) -> Float:
        """Peaks of one ping: centre frequency, bandwidth, then as ``Peaks.as_array``.

        Raises
        ------
        ValueError
            If the microphone is not there.
        """
        chirp, air = np.asarray(ping.chirp, float), ping.air
        size, c = FRAGMENT_SAMPLES + chirp.size, air.speed_of_sound_m_s
        division = Deconvolution(
            chirp,
            size,
            ping.chirp_band_hz,
            sensor=self.sensor,
            regularisation=self.regularisation,
            air=air,
        )
        first = round(2 * ping.range_m / c * AUDIO_RATE_HZ) - FRAGMENT_SAMPLES // 2
        heard = _piece(ping.audio, first, size)
        mics = ping.mic_positions_m
        if isinstance(self.microphone, int):
            if not 0 <= self.microphone < len(mics):
                raise ValueError(f"microphone {self.microphone}, expected 0 to {len(mics) - 1}")
            one = slice(self.microphone, self.microphone + 1)
            heard, mics = heard[one], mics[one]
        spectrum = _toward(ping, division, division.spectrum(heard), mics, first, c)
        response = division.impulse_response(spectrum[None], ping.range_m)[:, :FRAGMENT_SAMPLES]
        late_s = 2 * ping.range_m / c - (first + FRAGMENT_SAMPLES // 2) / AUDIO_RATE_HZ
        found = find_peaks(response, np.array([ping.range_m]), FRAGMENT_SAMPLES // 2)
        times_s = (found.time_s - late_s) * (c / _NOMINAL.speed_of_sound_m_s)
        row = Peaks(times_s, found.level_db, found.threshold_db).as_array()[0]
        return np.concatenate([[division.centre_hz, division.bandwidth_hz], row])

    def fit(self, prepared: npt.NDArray[Any], labels: Sequence[str]) -> None:
        """Learn levels, clutter and the odds of none.

        Parameters
        ----------
        prepared : shape (n, row)
            Stacked rows of ``prepare``, of one chirp.
        labels : n labels, ``r35`` or ``none``

        Raises
        ------
        ValueError
            If no label names a radius.
        """
        sizes = sorted(set(labels) - {NONE})
        radii = np.array([radius_m(label) or 0.0 for label in sizes])
        self.classes = (*sizes, NONE)
        centre_hz, bandwidth_hz = float(prepared[0, 0]), float(prepared[0, 1])
        c = _NOMINAL.speed_of_sound_m_s
        blank = PatternLikelihood(radii, centre_hz, bandwidth_hz, c, self.statistics)
        frontal = dict(zip(sizes, blank.pattern.level_db[:, 0].max(axis=1), strict=True))
        expected = np.array([frontal.get(label, np.nan) for label in labels])
        peaks = Peaks.from_array(prepared[:, 2:])
        span_s = FRAGMENT_SAMPLES / AUDIO_RATE_HZ
        statistics = fitted_statistics(self.statistics, peaks, expected, span_s)
        self.likelihood = PatternLikelihood(radii, centre_hz, bandwidth_hz, c, statistics)
        some = slice(None, None, -(-len(labels) // _THRESHOLD_ROWS))
        ratios = self.likelihood.log_ratios(Peaks.from_array(prepared[some, 2:]))
        self.log_odds_of_none = _best_odds(ratios, np.isnan(expected[some]))

    def predict(self, prepared: npt.NDArray[Any]) -> Float:
        """Probabilities in the order of ``classes``, shape (n, num_classes).

        Raises
        ------
        ValueError
            Before ``fit``.
        """
        if self.likelihood is None:
            raise ValueError("nothing was learnt yet: fit before predict")
        peaks = Peaks.from_array(prepared[:, 2:])
        return self.likelihood.probabilities(peaks, log_odds_of_none=self.log_odds_of_none)


def _piece(audio: npt.NDArray[np.float32], first: int, size: int) -> Float:
    """Samples from ``first`` on, silence beyond the ping."""
    piece = np.zeros((len(audio), size))
    start, stop = max(first, 0), min(first + size, audio.shape[1])
    if start < stop:
        piece[:, start - first : stop - first] = audio[:, start:stop]
    return piece


def _toward(
    ping: HeardPing,
    division: Deconvolution,
    spectrum: npt.NDArray[np.complex128],
    mics_m: Float,
    first: int,
    c: float,
) -> npt.NDArray[np.complex128]:
    """Mean of all microphones, delayed so that the told range falls into the fragment's middle."""
    known = np.isfinite(ping.azimuth_rad)
    azimuths = np.array([ping.azimuth_rad]) if known else _SEARCHED_RAD
    best, loudest = np.zeros(division.frequency_hz.size, np.complex128), -1.0
    for azimuth in azimuths:
        point = ping.range_m * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        ways = np.linalg.norm(point - ping.emitter_position_m) + np.linalg.norm(
            point - mics_m, axis=1
        )
        early_s = (ways - 2 * ping.range_m) / c
        turn = np.exp(2j * np.pi * early_s[:, None] * division.frequency_hz)
        beam = np.mean(spectrum * turn, axis=0)
        energy = float(np.sum(np.abs(beam) ** 2))
        if energy > loudest:
            best, loudest = beam, energy
    return best


def _best_odds(log_ratios: Float, is_none: npt.NDArray[np.bool_]) -> float:
    """Odds of none that tell dish from none most often; 0 where there is nothing to tell apart."""
    if is_none.all() or not is_none.any():
        return 0.0
    evidence = log_evidence(log_ratios)
    order = np.argsort(evidence)
    # With the threshold under row n of them, all before are called none.
    right = np.cumsum(np.where(is_none[order], 1, -1))
    best = int(right.argmax())
    above = min(best + 1, len(order) - 1)
    return float(evidence[order[[best, above]]].mean())
