"""The Galerkin matrices of a rigid screen, one per azimuthal mode.

The pressure jump q across a rigid screen makes the hypersingular equation
``d/dn integral q dG/dn' = -dp_inc/dn``. Maue's weak form moves both derivatives to q and the
test function w: ``integral integral G (k^2 n.n' w q - curl w . curl' q)`` with the surface curl
``n x grad`` (Colton and Kress, Inverse Acoustic and Electromagnetic Scattering, sec. 3.1).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_simulator.reference.azimuth import AzimuthRule
from ertis_simulator.reference.meridian import Curve, Panels
from ertis_simulator.reference.rules import PairRule, gauss, lagrange, next_panel, same_panel

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

_FAR_MARGIN = 5  # quadrature points beyond the polynomial's degree


def galerkin_matrices(
    panels: Panels, degree: int, wavenumber: float, num_modes: int
) -> ComplexArray:
    """Matrices over the nodes of all panels, shape (num_modes, num_nodes, num_nodes).

    Node ``panel * degree + j`` is node j of that panel; the axis and the rim are included.
    """
    size = len(panels) * degree + 1
    matrix = np.zeros((num_modes, size, size), np.complex128)
    _add_near(matrix, panels, degree, wavenumber)
    _add_far(matrix, panels, degree, wavenumber)
    return matrix


def _add_near(matrix: ComplexArray, panels: Panels, degree: int, wavenumber: float) -> None:
    bandwidth = wavenumber * panels.meridian.max_rho
    azimuth = AzimuthRule.peaked(len(matrix) + 1, bandwidth)
    for step, make_rule in ((0, same_panel), (1, next_panel)):
        rule = make_rule(degree)
        tables = _products(rule, degree)
        for first in range(len(panels) - step):
            near, near_slope = panels.at(np.array(first), rule.u)
            far, far_slope = panels.at(np.array(first + step), rule.v)
            green = azimuth.green(near, far, wavenumber)
            kernels = _maue_kernels(green, near, far, near_slope, far_slope, wavenumber)
            block = sum(k @ t for k, t in zip(kernels, tables, strict=True))
            block = np.reshape(block, (len(matrix), degree + 1, degree + 1))
            _place(matrix, block, first * degree, (first + step) * degree)


def _products(rule: PairRule, degree: int) -> list[FloatArray]:
    test, test_slope = lagrange(degree, rule.u)
    trial, trial_slope = lagrange(degree, rule.v)
    pairs = ((test, trial), (test_slope, trial_slope), (test_slope, trial), (test, trial_slope))
    return [
        np.einsum("p,pa,pb->pab", rule.weights, a, b).reshape(len(rule.u), -1) for a, b in pairs
    ]


def _add_far(matrix: ComplexArray, panels: Panels, degree: int, wavenumber: float) -> None:
    u, weights = gauss(degree + _FAR_MARGIN)
    basis, slopes = (part * weights[:, None] for part in lagrange(degree, u))
    meridian = panels.meridian
    decay = float(panels.lengths[:-1].min()) / meridian.max_rho
    azimuth = AzimuthRule.smooth(len(matrix) + 1, wavenumber * meridian.max_rho, decay)
    for first in range(len(panels) - 2):
        others = np.arange(first + 2, len(panels))
        shape = (len(u), len(others), len(u))
        near, near_slope = _spread(panels, np.array(first), u[:, None, None], shape)
        far, far_slope = _spread(panels, others[:, None], u, shape)
        green = azimuth.green(near, far, wavenumber)
        kernels = _maue_kernels(green, near, far, near_slope, far_slope, wavenumber)
        plain, curls, left, right = (k.reshape(len(matrix), *shape) for k in kernels)
        block = _project(basis, plain @ basis + right @ slopes)
        block += _project(slopes, left @ basis + curls @ slopes)
        for column, other in enumerate(others):
            _place(matrix, block[:, :, column], first * degree, int(other) * degree)


def _spread(
    panels: Panels, panel: npt.NDArray[np.int64], u: FloatArray, shape: tuple[int, ...]
) -> tuple[Curve, FloatArray]:
    curve, slope = panels.at(panel, u)

    def flat(values: FloatArray) -> FloatArray:
        return np.broadcast_to(values, shape).ravel()

    return Curve(*map(flat, (curve.rho, curve.z, curve.rho_s, curve.z_s))), flat(slope)


def _project(basis: FloatArray, kernel: ComplexArray) -> ComplexArray:
    shape = kernel.shape
    rows = basis.T @ kernel.reshape(shape[0], shape[1], -1)
    return np.asarray(rows.reshape(shape[0], basis.shape[1], *shape[2:]))


def _maue_kernels(
    green: ComplexArray,
    near: Curve,
    far: Curve,
    near_slope: FloatArray,
    far_slope: FloatArray,
    wavenumber: float,
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Weights of w q, w' q', w' q and w q' (slopes by the panels' coordinates)."""
    mode = np.arange(len(green) - 1)[:, None]
    below, here, above = np.concatenate([green[1:2], green[:-2]]), green[:-1], green[1:]
    cosine, sine = (above + below) / 2, mode * (above - below) / 2
    slopes, rings = near_slope * far_slope, near.rho * far.rho
    upright, level = near.z_s * far.z_s * slopes, near.rho_s * far.rho_s * slopes
    k2_rings = wavenumber**2 * rings
    plain = cosine * (k2_rings * upright - mode**2 * level)
    plain += here * (k2_rings * level - mode**2 * upright)
    scale = 4 * np.pi**2
    return (
        scale * plain,
        -scale * cosine * rings,
        scale * sine * (near.rho * far.rho_s * far_slope),
        scale * sine * (far.rho * near.rho_s * near_slope),
    )


def _place(matrix: ComplexArray, block: ComplexArray, row: int, column: int) -> None:
    count = block.shape[-1]
    matrix[:, row : row + count, column : column + count] += block
    matrix[:, column : column + count, row : row + count] += block.transpose(0, 2, 1)
