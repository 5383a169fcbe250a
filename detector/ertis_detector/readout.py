"""Where in a dish its echo comes from, how far it is turned, and how wrong both may be.

The peak of an echo is the two-bounce ring, (sqrt(2) - 1) R behind the vertex of a frontal dish,
R = 1.1333 a; a turned dish's vertex comes nearer by R (1 - cos tilt), and all of its glints
return along the line to the centre of its sphere, R in front of the vertex, so its bearing is off
by R sin(tilt) over the centre's range, to a side that the echo does not tell. Linear corrections
and the law of the errors are fitted.

Elevation has a law of its own nearby: emitter and array stand some 5 cm apart, one above the other,
and the ring's echo is a beam around the emitter, J0(k R sin(45 degrees) gap / range). Where its
first null falls on the array (R / range about 0.07) the microphones beyond it hear the opposite
phase, and the beam that sums them looks beside the echo. So variances are told over R / range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import radius_m
from ertis_detector.features import COHERENCE
from ertis_detector.place import GATE

Float32 = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

SPHERE_RADIUS = 1.1333  # in aperture radii: (a^2 + d^2) / (2 d a), d = 0.6 a
RING_OFFSET = (np.sqrt(2) - 1) * SPHERE_RADIUS
_MAX_TILT_RAD = np.deg2rad(60.0)
_RIDGE = 100.0
_BLOCKS = 5  # of neighbouring echoes, as those of one scene are not independent
_ROUNDS = 12  # of reweighting; the law has settled by then
# R / range between which variances go straight; densest around the nulls.
_SEEN = np.array([0.0, 0.03, 0.045, 0.06, 0.075, 0.09, 0.11, 0.13])
_CENTRE_OFFSET = np.sqrt(2) * SPHERE_RADIUS  # from the ring's range to that of the sphere's centre
NUM_TERMS = _SEEN.size + 5
_LEAST_COHERENCE = 1 / 32  # noise has that much by chance
_FLOORS = np.array([1e-3, 1e-3, 2e-3]) ** 2  # m2, rad2, rad2: no echo is better than that


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """Linear in the standardised features and the size.

    mean, scale : float32, shape (num_features,)
    weights : float32, shape (num_features + 1 + num_sizes, 2)
        To the vertex's offset from where the ring puts it, m, and the tilt, rad.
    variances : float32, shape (3, NUM_TERMS)
        Rows range, azimuth, elevation; what multiplies each of ``terms``.
    sizes : tuple of str
    """

    sizes: tuple[str, ...]
    mean: Float32
    scale: Float32
    weights: Float32
    variances: Float32

    def __call__(
        self, features: Float32, labels: Sequence[str], range_m: Float, snr_db: Float
    ) -> tuple[Float, Float, Float]:
        """Vertex ranges, tilts, and variances of (range, azimuth, elevation), m2 and rad2.

        Parameters
        ----------
        features : float32, shape (n, num_features)
        labels : n sizes
        range_m, snr_db : shape (n,)
            Of the echo's peak.

        Returns
        -------
        shapes (n,), (n,), (n, 3)
        """
        rows = design(features, labels, self.sizes, self.mean, self.scale)
        offset, tilt = (rows @ self.weights).astype(np.float64).T
        tilt = np.clip(tilt, 0.0, _MAX_TILT_RAD)
        spread = terms(features, labels, tilt, range_m, snr_db) @ self.variances.T
        return ring_to_vertex_m(labels, range_m) + offset, tilt, np.maximum(spread, _FLOORS)


def ring_to_vertex_m(labels: Sequence[str], range_m: Float) -> Float:
    """Range of a frontal dish's vertex, from that of its two-bounce ring; shape (n,)."""
    return np.asarray(range_m - RING_OFFSET * _radii_m(labels))


def design(
    features: Float32, labels: Sequence[str], sizes: Sequence[str], mean: Float32, scale: Float32
) -> Float32:
    """Standardised features, one, and the size as a row of ones and zeros."""
    standard = np.clip((features - mean) / scale, -5, 5)
    size = np.array([[float(label == one) for one in sizes] for label in labels], np.float32)
    ones = np.ones((len(features), 1), np.float32)
    return np.concatenate([standard, ones, size.reshape(len(features), -1)], axis=1)


def terms(
    features: Float32, labels: Sequence[str], tilt_rad: Float, range_m: Float, snr_db: Float
) -> Float:
    """What variances are made of, shape (n, NUM_TERMS).

    How large the sphere is seen, R / range, as shares of the knots around it; the square of the
    turn's offset of the bearing, and of its offset of the range, m2; the inverse of the
    signal-to-noise ratio; what in the echo's own window comes from elsewhere, against the echo,
    and its square.
    """
    sphere_m = SPHERE_RADIUS * _radii_m(labels)
    seen = np.clip(sphere_m / range_m, _SEEN[0], _SEEN[-1])
    centre_m = np.maximum(range_m - _CENTRE_OFFSET * _radii_m(labels), range_m / 2)
    aside = sphere_m * np.sin(tilt_rad) / centre_m
    coherence = np.clip(features[:, COHERENCE].mean(axis=1), _LEAST_COHERENCE, 1.0)
    foreign = (1 - coherence.astype(np.float64)) / coherence
    nearer_m = sphere_m * (1 - np.cos(tilt_rad))
    noise = 10 ** (-snr_db / 10)
    rest = np.stack([aside**2, nearer_m**2, noise, foreign, foreign**2], axis=1)
    return np.concatenate([_shares(seen), rest], axis=1)


def _shares(seen: Float) -> Float:
    """What of each value the knots below and above it have, shape (n, num_knots)."""
    below = np.minimum(np.searchsorted(_SEEN, seen, "right") - 1, _SEEN.size - 2)
    part = (seen - _SEEN[below]) / (_SEEN[below + 1] - _SEEN[below])
    shares = np.zeros((seen.size, _SEEN.size))
    row = np.arange(seen.size)
    shares[row, below], shares[row, below + 1] = 1 - part, part
    return shares


def _radii_m(labels: Sequence[str]) -> Float:
    return np.array([radius_m(label) or 0.0 for label in labels])


def fit_readout(
    features: Float32,
    labels: Sequence[str],
    place: Float,
    truth: Float,
    snr_db: Float,
) -> Readout:
    """Fit to located landmarks.

    Parameters
    ----------
    features : float32, shape (n, num_features)
    labels : n sizes
    place, truth : shape (n, 3) and (n, 4)
        Range, azimuth and elevation of the peak; of the vertex, with its tilt.
    snr_db : shape (n,)
    """
    whole = _without_law(features, labels, place, truth)
    vertex_m, tilt = np.zeros(len(labels)), np.zeros(len(labels))
    # Errors of echoes that the weights were fitted to are smaller than those of any other.
    for unseen in np.array_split(np.arange(len(labels)), _BLOCKS):
        known = np.setdiff1d(np.arange(len(labels)), unseen)
        others = [labels[i] for i in known]
        part = _without_law(features[known], others, place[known], truth[known], whole.sizes)
        here = [labels[i] for i in unseen]
        vertex_m[unseen], tilt[unseen], _ = part(
            features[unseen], here, place[unseen, 0], snr_db[unseen]
        )
    errors = np.stack([vertex_m, place[:, 1], place[:, 2]], axis=1) - truth[:, :3]
    basis = terms(features, labels, tilt, place[:, 0], snr_db)
    laws = [_variance_law(basis, e**2, floor) for e, floor in zip(errors.T, _FLOORS, strict=True)]
    return replace(whole, variances=np.stack(laws).astype(np.float32))


def _without_law(
    features: Float32,
    labels: Sequence[str],
    place: Float,
    truth: Float,
    sizes: tuple[str, ...] = (),
) -> Readout:
    """A read-out of places and tilts alone; of all sizes, where some may be missing."""
    sizes = sizes or tuple(sorted(set(labels)))
    mean = features.mean(axis=0)
    scale = np.maximum(features.std(axis=0), np.float32(1e-3))
    rows = design(features, labels, sizes, mean, scale)
    offset_m = truth[:, 0] - ring_to_vertex_m(labels, place[:, 0])
    wanted = np.stack([offset_m, truth[:, 3]], axis=1)
    # Errors are of two kinds, small and gross: the fit is of the small ones.
    kept = np.abs(offset_m - np.median(offset_m)) < 0.03
    weights = _ridge(rows[kept], wanted[kept])
    return Readout(sizes, mean, scale, weights, np.zeros((3, NUM_TERMS), np.float32))


def _ridge(rows: Float32, wanted: Float) -> Float32:
    rows64 = rows.astype(np.float64)
    matrix = rows64.T @ rows64 + _RIDGE * np.eye(rows.shape[1])
    return np.linalg.solve(matrix, rows64.T @ wanted).astype(np.float32)


def _variance_law(basis: Float, squares: Float, floor: float) -> Float:
    """Terms, none negative, whose sum is the mean square error everywhere: reweighted.

    Of what lies within a tracker's gate of it: what does not is another echo, not an error of this.
    """
    from scipy.optimize import nnls

    told = np.full(len(squares), squares.mean())
    for _ in range(_ROUNDS):
        weight = 1 / np.maximum(told, floor)
        weight[squares * weight > GATE] = 0.0
        law, _ = nnls(basis * weight[:, None], squares * weight)
        told = basis @ law
    return np.asarray(law)
