"""Where in a dish its echo comes from, how far it is turned, and how wrong both may be.

The peak of an echo is the two-bounce ring, (sqrt(2) - 1) R behind the vertex of a frontal dish,
R = 1.1333 a; a turned dish's vertex comes nearer by R (1 - cos tilt), and all of its glints
return along the line to the centre of its sphere, so its bearing is off by R sin(tilt) / range
to a side that the echo does not tell. Linear corrections and the law of the errors are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.detection import radius_m

Float32 = npt.NDArray[np.float32]
Float = npt.NDArray[np.float64]

SPHERE_RADIUS = 1.1333  # in aperture radii: (a^2 + d^2) / (2 d a), d = 0.6 a
RING_OFFSET = (np.sqrt(2) - 1) * SPHERE_RADIUS
_MAX_TILT_RAD = np.deg2rad(60.0)
_RIDGE = 100.0
NUM_TERMS = 4
_FLOORS = np.array([1e-3, 1e-3, 2e-3]) ** 2  # m2, rad2, rad2: no echo is better than that


@dataclass(frozen=True, slots=True, eq=False)
class Readout:
    """Linear in the standardised features and the size.

    mean, scale : float32, shape (num_features,)
    weights : float32, shape (num_features + 1 + num_sizes, 2)
        To the vertex's offset from where the ring puts it, m, and the tilt, rad.
    variances : float32, shape (3, NUM_TERMS)
        Rows range, azimuth, elevation; what multiplies 1, (R sin(tilt) / range)^2, (R / range)^2
        for the tilt is not known exactly, and the inverse of the signal-to-noise ratio.
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
        spread = terms(labels, tilt, range_m, snr_db) @ self.variances.T
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


def terms(labels: Sequence[str], tilt_rad: Float, range_m: Float, snr_db: Float) -> Float:
    """What variances are made of, shape (n, NUM_TERMS)."""
    seen = SPHERE_RADIUS * _radii_m(labels) / range_m
    aside = seen * np.sin(tilt_rad)
    return np.stack([np.ones_like(seen), aside**2, seen**2, 10 ** (-snr_db / 10)], axis=1)


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
    sizes = tuple(sorted(set(labels)))
    mean = features.mean(axis=0)
    scale = np.maximum(features.std(axis=0), np.float32(1e-3))
    rows = design(features, labels, sizes, mean, scale)
    range_m = place[:, 0]
    wanted = np.stack([truth[:, 0] - ring_to_vertex_m(labels, range_m), truth[:, 3]], axis=1)
    # Errors are of two kinds, small and gross: the fit is of the small ones.
    kept = np.abs(wanted[:, 0] - np.median(wanted[:, 0])) < 0.03
    weights = _ridge(rows[kept], wanted[kept])
    told = Readout(sizes, mean, scale, weights, np.zeros((3, NUM_TERMS), np.float32))
    vertex_m, tilt, _ = told(features, labels, range_m, snr_db)
    errors = np.stack([vertex_m, place[:, 1], place[:, 2]], axis=1) - truth[:, :3]
    basis = terms(labels, tilt, range_m, snr_db)
    variances = np.stack([_variance_law(basis, errors[:, k] ** 2) for k in range(3)])
    return Readout(sizes, mean, scale, weights, variances.astype(np.float32))


def _ridge(rows: Float32, wanted: Float) -> Float32:
    rows64 = rows.astype(np.float64)
    matrix = rows64.T @ rows64 + _RIDGE * np.eye(rows.shape[1])
    return np.linalg.solve(matrix, rows64.T @ wanted).astype(np.float32)


def _variance_law(basis: Float, squares: Float) -> Float:
    """Terms, none negative, whose sum is the mean square error everywhere: reweighted."""
    from scipy.optimize import nnls

    law = np.array([squares.mean(), 0.0, 0.0, 0.0])
    for _ in range(8):
        weight = 1 / np.maximum(basis @ law, 1e-8)
        law, _ = nnls(basis * weight[:, None], squares * weight)
    return np.asarray(law)
