"""Quadrature and polynomials on a panel, singular pairs of panels included.

After the azimuthal integral Green's function is left with a logarithm where two points of the
meridian meet. Duffy's map turns each such corner or diagonal into one edge, and a power
substitution makes the edge harmless to Gauss's rule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairRule:
    """Points (u, v) of the unit square of two panels, and their weights."""

    u: FloatArray
    v: FloatArray
    weights: FloatArray


def gauss(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on [0, 1]."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return (nodes + 1) / 2, weights / 2


def same_panel(degree: int) -> PairRule:
    """For the triangle v < u of a panel with itself: the kernel is symmetric."""
    x, weight_x = _graded_at_both_ends(degree + 14)
    gap, weight_t = _graded_at_zero(degree + 8, power=3)
    weights = np.outer(weight_x * x, weight_t)
    return PairRule(np.repeat(x, len(gap)), np.outer(x, 1 - gap).ravel(), weights.ravel())


def next_panel(degree: int) -> PairRule:
    """For a panel's end (u = 1) against the next one's start (v = 0)."""
    x, weight_x = _graded_at_zero(degree + 10, power=2)
    t, weight_t = gauss(degree + 2)
    near, far = np.repeat(x, len(t)), np.outer(x, t).ravel()
    weights = np.outer(weight_x * x, weight_t).ravel()
    return PairRule(1 - np.append(near, far), np.append(far, near), np.append(weights, weights))


def lagrange(degree: int, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Polynomials through the Gauss-Lobatto nodes of [0, 1], and their derivatives.

    Returns
    -------
    values, derivatives : float64, shape (len(u), degree + 1)
        Column j is 1 at node j and 0 at the others; nodes 0 and ``degree`` are the ends.
    """
    series = np.polynomial.legendre.Legendre.basis(degree)
    nodes = np.concatenate([[-1.0], np.sort(series.deriv().roots().real), [1.0]])
    inverse = np.linalg.inv(np.polynomial.legendre.legvander(nodes, degree))
    x = 2 * u - 1
    values = np.polynomial.legendre.legvander(x, degree) @ inverse
    slopes = np.polynomial.legendre.legval(
        x, np.polynomial.legendre.legder(np.eye(degree + 1), axis=0)
    )
    return values, 2 * slopes.T @ inverse


def _graded_at_zero(count: int, power: int) -> tuple[FloatArray, FloatArray]:
    t, weights = gauss(count)
    return t**power, weights * power * t ** (power - 1)


def _graded_at_both_ends(count: int) -> tuple[FloatArray, FloatArray]:
    t, weights = gauss(count)
    return t**3 * (10 - 15 * t + 6 * t**2), weights * 30 * t**2 * (1 - t) ** 2
