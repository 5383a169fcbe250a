"""What a user prints: landmarks, and the plate that holds several at known places.

The dish's concave face looks at the sonar; the boss on its convex back is for the mount. Lengths in
mm, as on the printer; z is the dish's axis, out of its opening, and 0 at its deepest point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_simulator.errors import SceneError
from ertis_simulator.landmark import Dish
from ertis_simulator.mesh import Mesh, lathe, perforated_plate

CHORD_ERROR_MM = 0.010  # between the true surface and its facets: a printed layer is 0.1 to 0.2
RIM_MM = 0.4  # one line of a usual nozzle: a thicker rim returns more of its own
MIN_RADIUS_MM, MAX_RADIUS_MM = 10.0, 150.0
_HOLE_STEPS = 24  # a quarter of a hole


@dataclass(frozen=True, slots=True)
class Mount:
    """The boss on the back.

    wall_mm : float
        Of the dish at its deepest point; it thins out to the rim's 0.4 mm.
    boss_radius_mm, boss_length_mm : float
        Of the cylinder; its length from the back's vertex.
    hole_radius_mm, hole_depth_mm : float
        Of the blind hole in it.
    """

    wall_mm: float = 3.0
    boss_radius_mm: float = 8.0
    boss_length_mm: float = 12.0
    hole_radius_mm: float = 2.5
    hole_depth_mm: float = 10.0


def landmark_mesh(radius_mm: float, mount: Mount | None = None) -> Mesh:
    """Mesh of a landmark that can be printed.

    Parameters
    ----------
    radius_mm : float
        Of the opening.
    mount
        Another boss than the usual one.

    Raises
    ------
    SceneError
        If no printable dish has these measures.
    """
    mount = mount or Mount()
    if not MIN_RADIUS_MM <= radius_mm <= MAX_RADIUS_MM:
        raise SceneError(
            f"radius {radius_mm:g} mm, expected {MIN_RADIUS_MM:g} to {MAX_RADIUS_MM:g}"
        )
    _check(radius_mm, mount)
    profile = landmark_profile(radius_mm, mount)
    # Half of the error to each of the two ways that a facet is bent.
    step = 2 * np.arccos(1 - CHORD_ERROR_MM / 2 / (radius_mm + RIM_MM))
    return lathe(profile, 4 * int(np.ceil(2 * np.pi / step / 4)))


def landmark_profile(radius_mm: float, mount: Mount) -> npt.NDArray[np.float64]:
    """Radius and z of a landmark's outline, from its deepest point round to the end of the hole.

    Returns
    -------
    float64, shape (n, 2)
    """
    dish = Dish.landmark(radius_mm)
    depth = 1000 * dish.depth_m
    inner = _arc(1000 * dish.sphere_radius_m, 0.0, radius_mm)
    rim = radius_mm + RIM_MM
    back_depth = depth + mount.wall_mm
    back_radius = (rim**2 + back_depth**2) / (2 * back_depth)
    back = _arc(back_radius, mount.boss_radius_mm, rim)[::-1] - (0.0, mount.wall_mm)
    end = -mount.wall_mm - mount.boss_length_mm
    boss = [
        (mount.boss_radius_mm, end),
        (mount.hole_radius_mm, end),
        (mount.hole_radius_mm, end + mount.hole_depth_mm),
        (0.0, end + mount.hole_depth_mm),
    ]
    inner[-1] = (radius_mm, depth)
    back[0] = (rim, depth)
    return np.concatenate([inner, back, boss])


def _arc(sphere_mm: float, from_mm: float, to_mm: float) -> npt.NDArray[np.float64]:
    """Radius and z of a sphere's lower part that touches z = 0, between two radii."""
    first, last = np.arcsin(from_mm / sphere_mm), np.arcsin(to_mm / sphere_mm)
    step = 2 * np.arccos(1 - CHORD_ERROR_MM / 2 / sphere_mm)
    angle = np.linspace(first, last, int(np.ceil((last - first) / step)) + 1)
    return np.column_stack([sphere_mm * np.sin(angle), sphere_mm * (1 - np.cos(angle))])


def plate_mesh(
    radii_mm: list[float],
    gap_mm: float = 10.0,
    thickness_mm: float = 5.0,
    mount: Mount | None = None,
) -> tuple[Mesh, list[float]]:
    """Mesh of a plate that holds landmarks in a row, and where their axes are.

    Each dish's boss is screwed onto the plate through a hole that lets its screw pass.

    Parameters
    ----------
    radii_mm
        Of the landmarks, from the left as one looks into them.
    gap_mm : float
        Between neighbours' rims.

    Returns
    -------
    Mesh, list of float
        And the axes' places along the plate, mm from its left end.

    Raises
    ------
    SceneError
        If there is no such plate.
    """
    mount = mount or Mount()
    if not radii_mm or len(radii_mm) > 20:
        raise SceneError(f"{len(radii_mm)} landmarks on a plate, expected 1 to 20")
    for radius in radii_mm:
        if not MIN_RADIUS_MM <= radius <= MAX_RADIUS_MM:
            raise SceneError(
                f"radius {radius:g} mm, expected {MIN_RADIUS_MM:g} to {MAX_RADIUS_MM:g}"
            )
    if not (0 <= gap_mm <= 1000 and 1 <= thickness_mm <= 50):
        raise SceneError(
            f"gap {gap_mm:g} mm and thickness {thickness_mm:g} mm, expected 0 to 1000 and 1 to 50"
        )
    widths = [2 * (radius + RIM_MM) + gap_mm for radius in radii_mm]
    clearance_mm = 0.25
    depth = 4 * mount.boss_radius_mm
    mesh = perforated_plate(
        widths, depth, thickness_mm, mount.hole_radius_mm + clearance_mm, _HOLE_STEPS
    )
    ends = np.cumsum(widths)
    return mesh, [float(end - width / 2) for end, width in zip(ends, widths, strict=True)]


def _check(radius_mm: float, mount: Mount) -> None:
    solid = mount.wall_mm + mount.boss_length_mm - mount.hole_depth_mm
    problems = (
        (mount.wall_mm < 2 * RIM_MM, f"wall {mount.wall_mm:g} mm, expected {2 * RIM_MM:g} or more"),
        (
            not 0 < mount.hole_radius_mm < mount.boss_radius_mm - 1,
            f"hole of radius {mount.hole_radius_mm:g} mm in a boss of {mount.boss_radius_mm:g} mm, "
            "expected a wall of 1 mm around it",
        ),
        (
            mount.boss_radius_mm > 0.8 * radius_mm,
            f"boss of radius {mount.boss_radius_mm:g} mm behind a dish of {radius_mm:g} mm, "
            "expected at most 0.8 of it",
        ),
        (
            not mount.hole_depth_mm > 0 or solid < 2,
            f"hole {mount.hole_depth_mm:g} mm deep leaves {solid:g} mm before the concave face, "
            "expected 2 or more",
        ),
    )
    for is_wrong, text in problems:
        if is_wrong:
            raise SceneError(text)
