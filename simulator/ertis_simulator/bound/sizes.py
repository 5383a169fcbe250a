"""Best size and presence from one ping, by Monte Carlo over interference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import i0e

from ertis_simulator.bound.templates import Receiver
from ertis_simulator.landmark import RADII_MM

Float = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex64]

TILT_STEP_RAD = np.deg2rad(5.0)  # the echoes of neighbours are 0.95 alike
MOST_TILT_RAD = np.deg2rad(60.0)
# Told within 2 cm, in steps of a third of what the band resolves.
LATE_S = np.arange(-20, 21) * 6e-6
FALSE_ALARMS = 1e-3  # a fragment
_SEEN_ALARMS = 1e-2  # from here on, the tail is that of an exponential law
_KEPT = 1e-3  # of the strongest singular value: what is weaker than that says nothing
KNOWN = ("level and range", "level", "nothing")


class Hypotheses(NamedTuple):
    """Every dish that is thought of.

    radius : index of the size, shape (num,)
    tilt_rad : to either side, shape (num,)
    whitened : complex64, shape (num, num_frequencies, rank)
    ratio : energy against interference of unit scale, shape (num,)
    """

    radius: npt.NDArray[np.intp]
    tilt_rad: Float
    whitened: Complex
    ratio: Float


@dataclass(frozen=True, slots=True, eq=False)
class Scores:
    """Shares of trials, each of shape (num_truths, num_ratios).

    right : one for each of ``KNOWN``, (len(KNOWN), num_truths, num_ratios)
        The size was right.
    detected : presence was seen, at ``FALSE_ALARMS``
    """

    right: Float
    detected: Float


def hypotheses(receiver: Receiver) -> Hypotheses:
    """All sizes at all tilts, in the few dimensions that their echoes span."""
    most = round(MOST_TILT_RAD / TILT_STEP_RAD)
    tilts = TILT_STEP_RAD * np.arange(-most, most + 1)
    radius = np.repeat(np.arange(len(RADII_MM)), tilts.size)
    tilt = np.tile(tilts, len(RADII_MM))
    heard = [receiver.heard(RADII_MM[r], t) for r, t in zip(radius, tilt, strict=True)]
    whitened = np.stack([receiver.whitened(one) for one in heard])
    # At one frequency all echoes come from nearly one direction: few combinations of microphones
    # matter, and noise is white in any of them.
    _, value, basis = np.linalg.svd(whitened.transpose(1, 0, 2), full_matrices=False)
    rank = int(np.max(np.sum(value > _KEPT * value[:, :1], axis=1)))
    kept = np.conj(basis[:, :rank])
    reduced = np.einsum("hfm,frm->hfr", whitened, kept).astype(np.complex64)
    return Hypotheses(radius, tilt, reduced, np.array([receiver.ratio(one) for one in heard]))


def one_side(all_of: Hypotheses) -> npt.NDArray[np.intp]:
    """Indices of hypotheses turned to one side: the other is their mirror image."""
    return np.flatnonzero(all_of.tilt_rad > -1e-9)


def score(
    receiver: Receiver,
    all_of: Hypotheses,
    which: npt.NDArray[np.intp],
    ratios_db: Sequence[float],
    trials: int,
    rng: np.random.Generator,
) -> Scores:
    """Try the best receiver.

    Parameters
    ----------
    receiver, all_of
    which : indices of the hypotheses that are true in turn
    ratios_db : signal-to-clutter
    trials : int
        Of each.
    rng
    """
    turn = np.exp(2j * np.pi * receiver.frequency_hz[:, None] * LATE_S).astype(np.complex64)
    energy = np.sum(np.abs(all_of.whitened) ** 2, axis=(1, 2))
    noise = [_correlated(all_of, _noise(all_of, trials, rng), turn) for _ in which]
    peaks = np.concatenate([_strongest(part, energy) for part in noise])
    threshold = np.quantile(peaks, 1 - _SEEN_ALARMS) + np.log(_SEEN_ALARMS / FALSE_ALARMS)
    right = np.zeros((len(KNOWN), len(which), len(ratios_db)))
    detected = np.zeros((len(which), len(ratios_db)))
    for row, truth in enumerate(which):
        own = _correlated(all_of, all_of.whitened[truth][None], turn)
        for column, ratio_db in enumerate(ratios_db):
            power = 10 ** (ratio_db / 10) / all_of.ratio[truth]
            heard = np.float32(power) * own + np.float32(np.sqrt(power)) * noise[row]
            detected[row, column] = np.mean(_strongest(heard, power * energy) > threshold)
            evidence = _evidence(heard, power * energy)
            for known, one in enumerate(evidence):
                said = _best_size(one, all_of)
                right[known, row, column] = np.mean(said == all_of.radius[truth])
    return Scores(right, detected)


def _noise(all_of: Hypotheses, trials: int, rng: np.random.Generator) -> Complex:
    shape = (trials, *all_of.whitened.shape[1:])
    drawn = rng.normal(size=(2, *shape)) * np.sqrt(0.5)
    return np.asarray(drawn[0] + 1j * drawn[1], np.complex64)


def _correlated(all_of: Hypotheses, heard: Complex, turn: Complex) -> Complex:
    """Of what is heard with each hypothesis at each delay, shape (num_heard, num, num_late)."""
    each = np.einsum("hfr,bfr->bhf", np.conj(all_of.whitened), heard, optimize=True)
    return np.asarray(each @ turn)


def _strongest(correlated: Complex, energy: Float) -> Float:
    """Matched subspace detector: most energy along any hypothesis, shape (num_heard,)."""
    power = np.abs(correlated).max(axis=2) ** 2
    return np.asarray((power / energy).max(axis=1))


def _evidence(correlated: Complex, energy: Float) -> list[Float]:
    """Log likelihood of each hypothesis for each of ``KNOWN``, shape (num_heard, num)."""
    size = np.abs(correlated)
    told = 2 * correlated[:, :, LATE_S.size // 2].real - energy
    # Phase is unknown with the delay: Rice's likelihood, averaged over it.
    level = np.log(i0e(2 * size)) + 2 * size
    free = size**2 / energy[:, None].astype(np.float32)
    return [np.asarray(told), _summed(level) - energy, _summed(free)]


def _summed(log_likelihood: npt.NDArray[np.floating]) -> Float:
    """Log of the mean over the last axis."""
    most = log_likelihood.max(axis=-1)
    return np.asarray(most + np.log(np.exp(log_likelihood - most[..., None]).mean(axis=-1)))


def _best_size(evidence: Float, all_of: Hypotheses) -> npt.NDArray[np.intp]:
    """Most probable size, tilts as likely each; shape (num_heard,)."""
    of_sizes = evidence.reshape(len(evidence), len(RADII_MM), -1)
    return np.asarray(_summed(of_sizes).argmax(axis=1))
