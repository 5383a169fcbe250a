"""Things that stand in a scene by name: what each kind is made of, and how large it may be.

Sizes not given are drawn from the ranges below, all of them ASSUMED. What a shape returns follows
from geometry where a closed form exists: pipes and box faces are specular (``lines``, ``panels``),
corners have the flat-plate formulas of radar, bowls and lampshades are dishes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ertis_simulator.clutter import CLUSTER_KINDS, Clutter, cluster
from ertis_simulator.landmark import DEPTH_RATIO, RIM_STRENGTH, Dish
from ertis_simulator.lines import Lines
from ertis_simulator.occlusion import Blocker
from ertis_simulator.panels import Panels
from ertis_simulator.path import Path
from ertis_simulator.points import REFERENCE_K, Points

FloatArray = npt.NDArray[np.float64]

CORNER_LOBE_RAD = np.deg2rad(20.0)  # half-width of a corner's return at -3 dB
BUSH_OPACITY = 0.6  # of what would pass through it, amplitude
STAND_RADIUS_M = 0.006  # a thin rod under a landmark
_FLAT_LOBE = 1.39  # a plate's sinc(k h sin t) is down by 3 dB there

# Kind -> size -> the range it is drawn from: uniform, m
# (depths of dishes: over the radius).
SIZES: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "pipe": {"radius_m": (0.008, 0.06), "base_m": (0.0, 0.0), "top_m": (0.8, 2.2)},
    "edge": {"base_m": (0.0, 0.0), "top_m": (0.6, 2.0)},
    "box": {
        "width_m": (0.2, 0.8),
        "depth_m": (0.2, 0.6),
        "base_m": (0.0, 0.0),
        "top_m": (0.3, 1.4),
    },
    "bush": {"radius_m": (0.15, 0.4), "base_m": (0.0, 0.4), "top_m": (0.8, 1.6)},
    "dihedral": {"side_m": (0.03, 0.12), "height_m": (0.3, 1.2)},
    "trihedral": {"side_m": (0.03, 0.10), "height_m": (0.3, 1.2)},
    "bowl": {"radius_m": (0.03, 0.12), "depth_m": (0.2, 1.0), "height_m": (0.3, 1.2)},
    "lampshade": {"radius_m": (0.06, 0.15), "depth_m": (0.9, 1.6), "height_m": (0.5, 1.6)},
}
DISH_KINDS = ("bowl", "lampshade")  # their depth is drawn in radii
LIKE_A_LANDMARK = 0.12  # a dish whose depth over radius is that near to 0.6 is one by another name


@dataclass(frozen=True, slots=True)
class DishObject:
    """A dish standing in the scene.

    label : str
        ``r48`` and so on for a landmark; any other word for a decoy, such as ``bowl``.
    vertex_m : (x, y, z)
        Deepest point of the concave face, world frame.
    facing_rad : (azimuth, elevation)
        Where the opening looks, world frame.
    path : Path or None
        On which it moves, as an offset from its first waypoint.
    rim_strength : float
        Of the rim's diffraction: 1 for a sharp edge, less for a tapered one.
    """

    label: str
    dish: Dish
    vertex_m: tuple[float, float, float]
    facing_rad: tuple[float, float]
    is_landmark: bool = True
    path: Path | None = None
    rim_strength: float = RIM_STRENGTH

    @property
    def axis(self) -> FloatArray:
        """Unit vector out of the opening, shape (3,)."""
        azimuth, elevation = self.facing_rad
        return np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )

    def vertex_at(self, time_s: float) -> FloatArray:
        """Where its vertex is at a time, shape (3,), world frame."""
        vertex = np.asarray(self.vertex_m)
        return vertex if self.path is None else vertex + self.path.offset_m(time_s)


@dataclass(frozen=True, slots=True, eq=False)
class Thing:
    """Something named that is no dish.

    kind : str
        One of ``SIZES``, or what the scene calls it.
    place_m : (x, y, z)
        Its middle, for truth and plots.
    """

    kind: str
    place_m: tuple[float, float, float]
    clutter: Clutter
    blockers: tuple[Blocker, ...] = ()
    path: Path | None = field(default=None)

    def offset_m(self, time_s: float) -> FloatArray:
        """How far it has moved at a time, shape (3,)."""
        return np.zeros(3) if self.path is None else self.path.offset_m(time_s)


def draw_sizes(kind: str, given: Mapping[str, float], rng: np.random.Generator) -> dict[str, float]:
    """Complete the sizes of one thing; a drawn dish comes out unlike a landmark."""
    drawn = {name: float(rng.uniform(*limits)) for name, limits in SIZES[kind].items()}
    if kind not in DISH_KINDS:
        return drawn | dict(given)
    ratio = drawn["depth_m"]
    while abs(ratio - DEPTH_RATIO) < LIKE_A_LANDMARK:
        ratio = float(rng.uniform(*SIZES[kind]["depth_m"]))
    if "depth_m" in given:
        drawn["radius_m"] = given["depth_m"] / ratio
    radius_m = given.get("radius_m", drawn["radius_m"])
    return drawn | {"depth_m": ratio * radius_m} | dict(given)


def make_thing(
    kind: str,
    x_m: float,
    y_m: float,
    facing_rad: float,
    sizes: Mapping[str, float],
    rng: np.random.Generator,
    path: Path | None = None,
) -> Thing:
    """Build a pipe, edge, box, bush, dihedral or trihedral; ``sizes`` as ``draw_sizes`` gives."""
    if kind in ("dihedral", "trihedral"):
        at = (x_m, y_m, sizes["height_m"])
        return Thing(kind, at, _corner(kind, at, facing_rad, sizes["side_m"]), path=path)
    base, top = sizes["base_m"], max(sizes["top_m"], sizes["base_m"])
    at = (x_m, y_m, (base + top) / 2)
    if kind == "box":
        corners = _rectangle(x_m, y_m, sizes["width_m"], sizes["depth_m"], facing_rad)
        blocker = Blocker.prism(corners, base, top)
        return Thing(kind, at, _box(corners, facing_rad, base, top), (blocker,), path)
    if kind == "bush":
        radius = sizes["radius_m"]
        shape = cluster(CLUSTER_KINDS["bush"], np.array(at), rng)
        spread = np.array([radius / 2, radius / 2, (top - base) / 4])
        centred = (shape.positions_m - at) / CLUSTER_KINDS["bush"].spread_m * spread + at
        glints = Points.all_round(centred, shape.lengths_m, shape.exponents)
        blocker = Blocker.cylinder(x_m, y_m, radius, base, top, BUSH_OPACITY)
        return Thing(kind, at, Clutter(glints), (blocker,), path)
    radius = sizes.get("radius_m", 0.0)
    lines = Lines(np.array([[[x_m, y_m, base], [x_m, y_m, top]]]), np.array([radius]))
    blockers = (Blocker.cylinder(x_m, y_m, radius, base, top),) if radius > 0 else ()
    return Thing(kind, at, Clutter(lines=lines), blockers, path)


def stand_for(dish: DishObject) -> Thing:
    """The rod that holds a landmark, from the floor up to where the dish hides it."""
    x, y, z = np.asarray(dish.vertex_m) - dish.axis * 2 * STAND_RADIUS_M
    return rod(float(x), float(y), float(z) - dish.dish.aperture_radius_m, dish.path)


def rod(x_m: float, y_m: float, top_m: float, path: Path | None = None) -> Thing:
    """A stand, with or without something on it; too thin, and too far behind, to hide anything."""
    ends = np.array([[[x_m, y_m, 0.0], [x_m, y_m, max(top_m, 0.01)]]])
    lines = Lines(ends, np.array([STAND_RADIUS_M]))
    return Thing("stand", (x_m, y_m, top_m / 2), Clutter(lines=lines), (), path)


def _rectangle(x_m: float, y_m: float, width: float, depth: float, facing_rad: float) -> FloatArray:
    """Corners seen from above, counter-clockwise, shape (4, 2); the front looks along facing."""
    c, s = np.cos(facing_rad), np.sin(facing_rad)
    local = np.array([[depth, -width], [depth, width], [-depth, width], [-depth, -width]]) / 2
    return np.asarray(local @ np.array([[c, s], [-s, c]]) + np.array([x_m, y_m]))


def _box(corners: FloatArray, facing_rad: float, base: float, top: float) -> Clutter:
    following = np.roll(corners, -1, axis=0)
    middle = (corners + following) / 2
    height = np.full(4, (base + top) / 2)
    width = np.linalg.norm(following - corners, axis=1)
    panels = Panels(
        np.column_stack([middle, height]),
        facing_rad + np.arange(4) * np.pi / 2,
        np.column_stack([width / 2, np.full(4, (top - base) / 2)]),
    )
    low, high = np.full(4, base), np.full(4, top)
    upright = np.stack([np.column_stack([corners, low]), np.column_stack([corners, high])], 1)
    level = np.stack([np.column_stack([corners, high]), np.column_stack([following, high])], 1)
    return Clutter(lines=Lines(np.concatenate([upright, level]), np.zeros(8)), panels=panels)


def _corner(kind: str, at: tuple[float, float, float], facing_rad: float, side_m: float) -> Clutter:
    """One glint at the inner corner, its middle looking level.

    Cross sections 4 pi L^4 / (3 lambda^2) of a trihedral and 8 pi L^4 / lambda^2 of a dihedral
    (Knott, Shaeffer, Tuley, Radar Cross Section); the scattering length is sqrt(sigma / 4 pi).
    """
    wavelength = 2 * np.pi / REFERENCE_K
    if kind == "trihedral":
        length, up = side_m**2 / (np.sqrt(3.0) * wavelength), CORNER_LOBE_RAD
    else:
        length = np.sqrt(2.0) * side_m**2 / wavelength
        up = _FLAT_LOBE / (REFERENCE_K * side_m)  # two plates: flat in elevation
    glints = Points(
        np.array([at]),
        np.array([length]),
        np.array([1.0]),
        np.array([[facing_rad, 0.0]]),
        np.array([[CORNER_LOBE_RAD, up]]),
    )
    return Clutter(glints)
