"""Cramer-Rao bounds: how well place and tilt could be told at best, by any unbiased estimate."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ertis_simulator.bound.templates import Receiver

Complex = npt.NDArray[np.complex128]

# Half steps of the differences; the table's tilts are 2.5 degrees apart, and straight between.
_RANGE_M, _ANGLE_RAD, _TILT_RAD = 5e-5, np.deg2rad(0.02), np.deg2rad(1.25)


class PlaceBound(NamedTuple):
    """Standard deviations; each is divided by 10^(ratio_db / 20) at another ratio."""

    range_m: float
    azimuth_rad: float
    elevation_rad: float
    tilt_rad: float


def place_bound(
    receiver: Receiver, radius_mm: float, tilt_rad: float, ratio_db: float = 0.0
) -> PlaceBound:
    """Bounds for one dish whose size is known, all four unknown together, and level and phase.

    Parameters
    ----------
    receiver : Receiver
        With all microphones: a beam has no direction.
    radius_mm, tilt_rad : float
    ratio_db : float
        Signal-to-clutter at one microphone.

    Raises
    ------
    ValueError
        For a receiver with one beam.
    """
    if receiver.one_beam:
        raise ValueError("one beam tells no direction: give a receiver with all microphones")
    own = receiver.heard(radius_mm, tilt_rad)
    power = 10 ** (ratio_db / 10) / receiver.ratio(own)
    echo = receiver.whitened(own).ravel()
    slopes = np.stack(
        [
            (
                receiver.whitened(_moved(receiver, radius_mm, tilt_rad, name, half))
                - receiver.whitened(_moved(receiver, radius_mm, tilt_rad, name, -half))
            ).ravel()
            / (2 * half)
            for name, half in (
                ("range_m", _RANGE_M),
                ("azimuth_rad", _ANGLE_RAD),
                ("elevation_rad", _ANGLE_RAD),
                ("tilt", _TILT_RAD),
            )
        ]
    )
    # Level and phase are unknown: what looks like a change of them says nothing.
    along = slopes @ np.conj(echo) / np.sum(np.abs(echo) ** 2)
    across = slopes - along[:, None] * echo
    information = 2 * power * (across @ np.conj(across).T).real
    # Four units of very different size: scaled, the inverse is well conditioned.
    scale = np.sqrt(np.diag(information))
    inverse = np.linalg.inv(information / np.outer(scale, scale))
    return PlaceBound(*(float(one) for one in np.sqrt(np.diag(inverse)) / scale))


def _moved(receiver: Receiver, radius_mm: float, tilt_rad: float, name: str, by: float) -> Complex:
    if name == "tilt":
        return receiver.heard(radius_mm, tilt_rad + by)
    place = receiver.place
    return receiver.heard(radius_mm, tilt_rad, replace(place, **{name: getattr(place, name) + by}))
