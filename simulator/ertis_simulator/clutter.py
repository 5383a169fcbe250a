"""Clutter: everything in a scene that is neither wall nor dish, as glints, lines and panels.

The statistics of small things stand here, all of them ASSUMED, kept together so that they can be
varied. One cluster stands for one thing: a plant, a tool, a cable duct, a stack of boxes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ertis_simulator.echoes import Echoes
from ertis_simulator.lines import Lines
from ertis_simulator.panels import Panels
from ertis_simulator.path import Pose
from ertis_simulator.points import Points

FloatArray = npt.NDArray[np.float64]

CLUSTER_SPREAD_DB, GLINT_SPREAD_DB = 4.0, 3.0  # standard deviations: of things, within a thing
DEFAULT_TOP_M = 1.6


@dataclass(frozen=True, slots=True)
class ClusterKind:
    """How one class of small things scatters.

    num_glints : (fewest, most)
    spread_m : standard deviation along x, y, z
    level_db : scattering length of a glint at 50 kHz, re 1 m, median
    exponents : one is drawn for each thing; spectrum f**exponent
    trail_m : later glints stand so far behind the first, and are stronger: a concave thing, whose
        inner ways are longer than its front and focus
    """

    num_glints: tuple[int, int]
    spread_m: tuple[float, float, float]
    level_db: float
    exponents: tuple[float, ...]
    trail_m: float = 0.0


CLUSTER_KINDS: Mapping[str, ClusterKind] = {
    # Table and shelf rims, cable ducts: some points of a diffracting line answer.
    "edge": ClusterKind((2, 6), (0.15, 0.15, 0.03), -36.0, (-0.5,)),
    # Legs, handles, bottles: one or two round fronts, which reflect any frequency alike.
    "pipe": ClusterKind((1, 3), (0.02, 0.02, 0.10), -31.0, (0.0,)),
    # Plants, cables, cloth: many small leaves, the better the shorter the wave.
    "bush": ClusterKind((12, 36), (0.12, 0.12, 0.15), -36.0, (0.5, 1.0)),
    # Cartons, tools, devices: faces and their rims.
    "box": ClusterKind((3, 8), (0.08, 0.08, 0.08), -33.0, (0.0, 0.5, 1.0)),
    # Cups, lamp sockets, corners of things: a front, then stronger ways through the inside.
    "concave": ClusterKind((2, 5), (0.01, 0.01, 0.01), -33.0, (0.5, 1.0), trail_m=0.03),
}
EVEN: Mapping[str, float] = dict.fromkeys(CLUSTER_KINDS, 1.0)
_TRAIL_GAIN_DB = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Clutter:
    """What stands about, by the shape of its echo."""

    points: Points = field(default_factory=Points.none)
    lines: Lines = field(default_factory=Lines.none)
    panels: Panels = field(default_factory=Panels.none)

    @classmethod
    def none(cls) -> Clutter:
        """An empty room."""
        return cls()

    @classmethod
    def join(cls, parts: Sequence[Clutter]) -> Clutter:
        """All of all parts."""
        parts = [*parts, cls()]
        return cls(
            Points.join([part.points for part in parts]),
            Lines.join([part.lines for part in parts]),
            Panels.join([part.panels for part in parts]),
        )

    @classmethod
    def scatter(
        cls,
        x_m: tuple[float, float],
        y_m: tuple[float, float],
        density_per_m2: float,
        rng: np.random.Generator,
        top_m: float = DEFAULT_TOP_M,
        weights: Mapping[str, float] = EVEN,
    ) -> Clutter:
        """Small things strewn over a rectangle, up to ``top_m`` high.

        Parameters
        ----------
        x_m, y_m : (low, high)
        density_per_m2 : float
            Things (clusters of glints) a square metre of floor.
        weights
            How common each of ``CLUSTER_KINDS`` is.
        """
        area = (x_m[1] - x_m[0]) * (y_m[1] - y_m[0])
        number = int(rng.poisson(density_per_m2 * area))
        low, high = np.array([x_m[0], y_m[0], 0.0]), np.array([x_m[1], y_m[1], top_m])
        share = np.array([weights.get(name, 0.0) for name in CLUSTER_KINDS])
        kinds = rng.choice(len(share), number, p=share / share.sum())
        places = rng.uniform(low, high, (number, 3))
        known = list(CLUSTER_KINDS.values())
        parts = [
            cluster(known[kind], place, rng) for kind, place in zip(kinds, places, strict=True)
        ]
        return cls(Points.join([*parts, Points.none()]))

    def shifted(self, offset_m: FloatArray) -> Clutter:
        """The same things elsewhere."""
        return Clutter(
            self.points.shifted(offset_m),
            self.lines.shifted(offset_m),
            self.panels.shifted(offset_m),
        )

    def echoes(self, pose: Pose, emitter: FloatArray, mics: FloatArray) -> list[Echoes]:
        """Their echoes for a sonar at ``pose``; emitter and mics in the sensor frame."""
        return [
            part.echoes(pose, emitter, mics)
            for part, size in (
                (self.points, len(self.points.lengths_m)),
                (self.lines, len(self.lines.radius_m)),
                (self.panels, len(self.panels.facing_rad)),
            )
            if size
        ]


def cluster(kind: ClusterKind, centre_m: FloatArray, rng: np.random.Generator) -> Points:
    """One thing of a kind."""
    low, high = kind.num_glints
    count = int(rng.integers(low, high + 1))
    positions = centre_m + rng.normal(0.0, 1.0, (count, 3)) * kind.spread_m
    level = kind.level_db + rng.normal(0.0, CLUSTER_SPREAD_DB) + np.zeros(count)
    level += rng.normal(0.0, GLINT_SPREAD_DB, count)
    if kind.trail_m:
        behind = np.r_[0.0, rng.uniform(0.3, 2.0, count - 1)] * kind.trail_m
        heading = rng.uniform(-np.pi, np.pi)
        positions = positions + np.outer(behind, [np.cos(heading), np.sin(heading), 0.0])
        level += np.where(behind > 0, _TRAIL_GAIN_DB, 0.0)
    lengths = rng.choice([-1.0, 1.0], count) * 10 ** (level / 20)
    exponents = np.full(count, rng.choice(kind.exponents))
    return Points.all_round(positions, lengths, exponents)
