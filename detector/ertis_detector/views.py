"""From where a landmark was heard, and how alike two hearings must sound for that reason alone."""

from __future__ import annotations

import math

import numpy as np

from ertis_detector.motion import Float

# Over these changes of view likeness falls to 1/e: of the side from which the sensor looks, of its
# range, and of the bearing (the beams of emitter and array). Measured on simulated echoes, where
# log odds of one thing at two views correlated so: docs/tracker.md.
CLASS_LENGTHS = np.array([math.radians(3.0), 0.5, math.radians(10.0)])
PLACE_LENGTHS = np.array([math.radians(1.0), 0.05, math.radians(10.0)])


class View:
    """From where something is seen: side, range and bearing.

    The side is the direction of the line of sight in a frame that does not turn with the sensor. It
    is counted from odometry alone: without it a sensor that turns and one that goes around
    something see the same, and nothing is taken for new that may be old.
    """

    def __init__(self, range_m: float, azimuth_rad: float) -> None:
        self.values = np.array([0.0, range_m, azimuth_rad])

    def go_round(self, angle_rad: float) -> None:
        """The sensor is now on another side, by so much."""
        self.values[0] += angle_rad

    def look(self, range_m: float, azimuth_rad: float) -> None:
        """It is now at this range and bearing."""
        self.values[1:] = range_m, azimuth_rad


def likeness(a: Float, b: Float, lengths: Float) -> Float:
    """exp(-distance) of views, shapes (..., 3); 1 for the same view."""
    return np.asarray(np.exp(-np.sqrt((((a - b) / lengths) ** 2).sum(axis=-1))))
