"""The paper's own pipeline, told the range: 20 spectral bins and a linear SVM, one against one.

Known range +-20 cm, 1024 samples at 450 kHz, tapered, band-passed 30-100 kHz, FFT magnitude in
20 linearly spaced bins. What the text leaves open is a field of ``PaperChoices``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.detection import NONE
from ertis_detector.errors import EvaluationError
from ertis_detector.imaging import AUDIO_RATE_HZ
from ertis_detector.method import KnownRangePing
from ertis_detector.paper_choices import PaperChoices

if TYPE_CHECKING:
    from sklearn.svm import SVC

Float = npt.NDArray[np.float64]

FRAGMENT_SAMPLES = 1024  # 2.28 ms: +-19.5 cm at 343 m/s, the paper's 20 cm
BAND_HZ = (30e3, 100e3)
_FLAT_PART = 0.5  # of the Tukey window
_LEAST_DB = -120.0


def paper_features(ping: KnownRangePing, choices: PaperChoices) -> Float:
    """The spectral bins of the fragment around the label's range.

    Returns
    -------
    float64, shape (num_bins,)

    Raises
    ------
    EvaluationError
        If the range lies outside the ping, or a microphone or azimuth is wanted that is not there.
    """
    fragments, late_s = _fragments(ping, choices)
    fragments = _band_passed(fragments * _window(choices.taper), choices.filter_order)
    spectrum = scipy.fft.rfft(fragments, axis=1)
    if choices.microphone in ("sum", "beam"):
        frequency_hz = scipy.fft.rfftfreq(FRAGMENT_SAMPLES, 1 / AUDIO_RATE_HZ)
        phase = np.exp(2j * np.pi * frequency_hz * late_s[:, None])
        spectrum = np.mean(spectrum * phase, axis=0, keepdims=True)
    magnitude = np.abs(spectrum)
    if choices.spreading == "undone":
        magnitude *= ping.range_m**2
    if choices.magnitude == "power":
        magnitude **= 2
    bins = _binned(magnitude, choices).mean(axis=0)
    if choices.magnitude == "db":
        bins = 20 * np.log10(np.maximum(bins, 10 ** (_LEAST_DB / 20)))
    return np.asarray(bins)


def _fragments(ping: KnownRangePing, choices: PaperChoices) -> tuple[Float, Float]:
    """Fragments (num_mics, 1024), and by how much each is later than its first sample says, s."""
    c = ping.air.speed_of_sound_m_s
    audio = ping.audio
    delay_s = np.full(len(audio), 2 * ping.range_m / c)
    if choices.microphone == "beam":
        delay_s = _delays_s(ping, c)
    elif choices.microphone.isdecimal():
        number = int(choices.microphone)
        if number >= len(audio):
            raise EvaluationError(f"microphone {number}, expected 0 to {len(audio) - 1}")
        audio, delay_s = audio[number : number + 1], delay_s[number : number + 1]
    if not 0 <= delay_s[0] * AUDIO_RATE_HZ < audio.shape[1]:
        raise EvaluationError(
            f"range {ping.range_m:g} m lies outside a ping of "
            f"{audio.shape[1] / AUDIO_RATE_HZ * c / 2:.2f} m: correct its label"
        )
    compressed = choices.sound == "compressed"
    if choices.placing == "middle" and not compressed:
        delay_s = delay_s + ping.chirp.size / AUDIO_RATE_HZ / 2
    nearest = np.rint(delay_s * AUDIO_RATE_HZ).astype(np.intp)
    more = ping.chirp.size if compressed else 0
    heard = _cropped(audio, nearest - FRAGMENT_SAMPLES // 2, FRAGMENT_SAMPLES + more)
    if compressed:
        heard = _compressed(heard, ping.chirp)
    return heard, delay_s - nearest / AUDIO_RATE_HZ


def _delays_s(ping: KnownRangePing, c: float) -> Float:
    """From the emitter to where the label points, level with the array, to each microphone."""
    if np.isnan(ping.azimuth_rad):
        raise EvaluationError("microphone=beam needs the label's azimuth, and a ping has none")
    point = ping.range_m * np.array([np.cos(ping.azimuth_rad), np.sin(ping.azimuth_rad), 0.0])
    out = np.linalg.norm(point - ping.emitter_position_m)
    back = np.linalg.norm(point - ping.mic_positions_m, axis=1)
    return np.asarray((out + back) / c)


def _cropped(audio: npt.NDArray[np.float32], first: npt.NDArray[np.intp], length: int) -> Float:
    """From each microphone's ``first`` sample on; silence beyond the ping."""
    index = first[:, None] + np.arange(length)
    inside = (index >= 0) & (index < audio.shape[1])
    rows = np.arange(len(audio))[:, None]
    taken = audio[rows, np.clip(index, 0, audio.shape[1] - 1)]
    return np.asarray(np.where(inside, taken, 0.0), np.float64)


def _compressed(heard: Float, chirp: Float) -> Float:
    """Matched filter: sample n is the correlation with a chirp that begins there."""
    size = scipy.fft.next_fast_len(heard.shape[1] + chirp.size, real=True)
    spectrum = scipy.fft.rfft(heard, size, axis=1) * np.conj(scipy.fft.rfft(chirp, size))
    matched = scipy.fft.irfft(spectrum, size, axis=1)[:, :FRAGMENT_SAMPLES]
    return np.asarray(matched / np.sqrt(np.sum(chirp**2)))


@cache
def _window(kind: str) -> Float:
    from scipy.signal import windows

    if kind == "none":
        return np.ones(FRAGMENT_SAMPLES)
    if kind == "tukey":
        return np.asarray(windows.tukey(FRAGMENT_SAMPLES, 1 - _FLAT_PART))
    return np.asarray(windows.get_window(kind, FRAGMENT_SAMPLES, fftbins=False))


def _band_passed(fragments: Float, order: int) -> Float:
    if order == 0:
        return fragments
    from scipy.signal import sosfilt

    return np.asarray(sosfilt(_butterworth(order), fragments, axis=1))


@cache
def _butterworth(order: int) -> Float:
    from scipy.signal import butter

    return np.asarray(butter(order, BAND_HZ, "bandpass", fs=AUDIO_RATE_HZ, output="sos"))


def _binned(magnitude: Float, choices: PaperChoices) -> Float:
    spacing_hz = AUDIO_RATE_HZ / FRAGMENT_SAMPLES
    if choices.binning == "point":
        lines = np.rint(np.linspace(*BAND_HZ, choices.num_bins) / spacing_hz).astype(np.intp)
        return np.asarray(magnitude[:, lines])
    edges = np.rint(np.linspace(*BAND_HZ, choices.num_bins + 1) / spacing_hz).astype(np.intp)
    sums = np.add.reduceat(magnitude[:, : edges[-1]], edges[:-1], axis=1)
    return np.asarray(sums / np.diff(edges))


class PaperMethod:
    """The paper's method, as ``method.Method`` wants it.

    Its "probabilities" are in the order of the SVM's decisions and no more: a linear SVM has none.
    """

    def __init__(self, choices: PaperChoices | None = None, name: str = "paper's SVM") -> None:
        self.name = name
        self.choices = PaperChoices() if choices is None else choices
        self.classes: tuple[str, ...] = ()

    def prepare(self, ping: KnownRangePing) -> Float:
        """The spectral bins, shape (num_bins,)."""
        return paper_features(ping, self.choices)

    def fit(self, prepared: npt.NDArray[Any], labels: Sequence[str]) -> None:
        """Fit detection and size, or all at once.

        Raises
        ------
        EvaluationError
            Without pings of ``none`` and of two sizes.
        """
        names = np.asarray(labels)
        sizes = sorted(set(labels) - {NONE})
        if len(sizes) < 2 or NONE not in labels:
            raise EvaluationError(
                f"labels {', '.join(sorted(set(labels)))}: expected two landmarks at least, "
                f"and {NONE}"
            )
        self.classes = (*sizes, NONE)
        rows = self._lengthened(prepared)
        self._offset, self._scale = _scaling(rows, self.choices.scaling)
        scaled = (rows - self._offset) / self._scale
        if self.choices.stages == "one":
            self._whole = self._svm().fit(scaled, names)
            return
        landmark = names != NONE
        self._detection = self._svm().fit(scaled, landmark)
        self._size = self._svm().fit(scaled[landmark], names[landmark])

    def predict(self, prepared: npt.NDArray[Any]) -> Float:
        """Shape (n, num_classes); ``none`` is above one half where the SVM says none."""
        scaled = (self._lengthened(prepared) - self._offset) / self._scale
        if self.choices.stages == "one":
            order = [list(self._whole.classes_).index(name) for name in self.classes]
            said = self._whole.decision_function(scaled)[:, order]
            sizes, present = said[:, :-1], said[:, :-1].max(axis=1) - said[:, -1]
        else:
            present = self._detection.decision_function(scaled)
            sizes = _per_class(self._size, scaled)
        landmark = 1 / (1 + np.exp(-np.clip(present, -30, 30)))
        lifted = np.exp(sizes - sizes.max(axis=1, keepdims=True))
        share = lifted / lifted.sum(axis=1, keepdims=True)
        return np.column_stack([landmark[:, None] * share, 1 - landmark])

    def _lengthened(self, prepared: npt.NDArray[Any]) -> Float:
        rows = np.asarray(prepared, np.float64)
        if self.choices.scaling != "unit":
            return rows
        return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-30))

    def _svm(self) -> SVC:
        from sklearn.svm import SVC

        # "ovr" only shapes what is told: fitting is one against one, and so is the vote.
        weight = "balanced" if self.choices.weighting == "balanced" else None
        return SVC(
            kernel="linear",
            C=self.choices.penalty,
            class_weight=weight,
            decision_function_shape="ovr",
        )


def kindest() -> PaperMethod:
    """The kindest reading of the text: whole echoes, each spectrum scaled to one length.

    A raw crop cuts a 2.5 ms chirp's echo in two, and from 0.6 to 4.2 m an echo loses 34 dB by
    spreading alone. The text says nothing of either, and its pipeline should not be beaten by that
    silence (docs/decisions/0006).
    """
    choices = PaperChoices(sound="compressed", scaling="unit")
    return PaperMethod(choices, "paper's SVM, kindest reading")


def _per_class(svm: SVC, scaled: Float) -> Float:
    """Votes of each class, ties broken by margins; shape (n, num_classes)."""
    said = np.asarray(svm.decision_function(scaled))
    return np.column_stack([-said, said]) if said.ndim == 1 else said


def _scaling(rows: Float, kind: str) -> tuple[Float, Float]:
    """Offset and scale of each feature, from the pings that are learnt from."""
    if kind == "none":
        return np.zeros(rows.shape[1]), np.ones(rows.shape[1])
    if kind == "minmax":
        low, high = rows.min(axis=0), rows.max(axis=0)
        return low, np.maximum(high - low, 1e-30)
    return rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-30)
