"""The baseline: aperture radii from the peaks of an impulse response.

After Simon et al., Bioinspired sonar reflectors as guiding beacons (PNAS 117, 2020): a broadband
sonar sees a dish's glints as separate peaks, and the times between them tell its radius. Nothing
here knows of glints that blur into one peak: that is what fails on narrow bands, and why it is the
baseline (``docs/baseline.md``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ertis_detector.deconvolution import REGULARISATION, Deconvolution, Table
from ertis_detector.peak_finding import Peaks, find_peaks
from ertis_detector.peak_likelihood import TILTS_RAD, PatternLikelihood, PeakStatistics

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

FRAGMENT_SAMPLES = 1024  # the paper's +-20 cm


class PeakPattern:
    """Probabilities of aperture radii, from fragments.

    Parameters
    ----------
    radii_m : sequence of float
        Any.
    chirp : float64, shape (n,)
        The emitted sweep at 450 kHz.
    band_hz : (low, high)
        Used for the division.
    num_samples : int
        Of a fragment, whose middle is at the range that is told. Audio that goes on for a chirp's
        length behind it gives whole echoes.
    sensor, regularisation
        As of ``Deconvolution``.
    speed_of_sound_m_s : float
    statistics : PeakStatistics
    tilts_rad : shape (num_tilts,)
        As of ``PatternLikelihood``.

    Raises
    ------
    ValueError
        If there is no radius, or one is not positive; if the band is none.
    """

    def __init__(
        self,
        radii_m: Sequence[float],
        chirp: Float,
        band_hz: tuple[float, float],
        *,
        num_samples: int = FRAGMENT_SAMPLES,
        sensor: Table | None = None,
        regularisation: float = REGULARISATION,
        speed_of_sound_m_s: float = 343.2,
        statistics: PeakStatistics | None = None,
        tilts_rad: Float = TILTS_RAD,
    ) -> None:
        self.num_samples = num_samples
        self.deconvolution = Deconvolution(
            chirp, num_samples + chirp.size, band_hz, sensor=sensor, regularisation=regularisation
        )
        self.likelihood = PatternLikelihood(
            np.asarray(radii_m, float),
            self.deconvolution.centre_hz,
            self.deconvolution.bandwidth_hz,
            speed_of_sound_m_s,
            statistics or PeakStatistics(),
            tilts_rad,
        )

    def impulse_response(self, fragments: npt.NDArray[np.floating], range_m: Float) -> Complex:
        """Divide fragments by the chirp.

        Parameters
        ----------
        fragments : shape (n, num_samples) or longer by up to a chirp's length
        range_m : shape (n,)

        Returns
        -------
        complex128, shape (n, num_samples)
        """
        whole = self.deconvolution.num_samples
        if fragments.ndim != 2 or not self.num_samples <= fragments.shape[1] <= whole:
            raise ValueError(
                f"fragments of shape {fragments.shape}, expected (n, {self.num_samples}) to "
                f"(n, {whole}): a fragment, and at most a chirp after it"
            )
        padded = np.zeros((len(fragments), whole))
        padded[:, : fragments.shape[1]] = fragments
        return self.deconvolution(padded, range_m)[:, : self.num_samples]

    def peaks(self, fragments: npt.NDArray[np.floating], range_m: Float) -> Peaks:
        """Peaks of fragments; arguments as of ``impulse_response``."""
        response = self.impulse_response(fragments, range_m)
        return find_peaks(response, np.asarray(range_m, float), self.num_samples // 2)

    def probabilities(
        self,
        fragments: npt.NDArray[np.floating],
        range_m: Float,
        *,
        log_odds_of_none: float = 0.0,
    ) -> Float:
        """Probabilities of each radius and, last, of none: shape (n, num_radii + 1).

        Parameters
        ----------
        fragments, range_m
            As of ``impulse_response``.
        log_odds_of_none : float
            Of no dish against any, before anything is heard.
        """
        peaks = self.peaks(fragments, range_m)
        return self.likelihood.probabilities(peaks, log_odds_of_none=log_odds_of_none)
