"""Triangle meshes: a lathe, plates with holes, and files that printers read. Lengths in mm.

Millimetres, not metres: that is what STL means to every slicer, and 3MF's own unit.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
_STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_HEADER_BYTES = 80
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest there is: the same mesh makes the same bytes
_CONTENT_TYPES = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
    '<Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
    '<Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>\n'
)
_RELATIONSHIPS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
    '<Relationship Target="/3D/3dmodel.model" Id="model" '
    'Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>\n'
)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A closed surface.

    vertices_mm : float64, shape (num_vertices, 3)
    triangles : int64, shape (num_triangles, 3)
        Rows of ``vertices_mm``, counterclockwise seen from outside.
    """

    vertices_mm: Float
    triangles: npt.NDArray[np.int64]

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Extent along x, y and z."""
        extent = np.ptp(self.vertices_mm, axis=0)
        return float(extent[0]), float(extent[1]), float(extent[2])


def lathe(profile_mm: Float, num_around: int) -> Mesh:
    """Turn a profile about the z axis.

    Parameters
    ----------
    profile_mm : shape (n, 2)
        Radius and z; first and last on the axis, all others off it. The outside is to the left of
        the way from first to last.
    num_around : int
        Vertices on each circle.

    Raises
    ------
    ValueError
        If the profile does not begin and end on the axis, or touches it in between.
    """
    radius, height = profile_mm.T
    if radius[0] != 0 or radius[-1] != 0 or np.any(radius[1:-1] <= 0):
        raise ValueError("profile: expected its ends, and nothing else, on the axis")
    angle = 2 * np.pi * np.arange(num_around) / num_around
    rings = np.empty((len(profile_mm) - 2, num_around, 3))
    rings[..., 0] = radius[1:-1, None] * np.cos(angle)
    rings[..., 1] = radius[1:-1, None] * np.sin(angle)
    rings[..., 2] = height[1:-1, None]
    poles = np.array([[0, 0, height[0]], [0, 0, height[-1]]])
    vertices = np.concatenate([rings.reshape(-1, 3), poles])
    here = np.arange(num_around)
    onward = np.roll(here, -1)
    row = num_around * np.arange(len(rings) - 1)[:, None]
    a, b = row + here, row + onward
    c, d = a + num_around, b + num_around
    first = np.full(num_around, len(vertices) - 2)
    last = np.full(num_around, len(vertices) - 1)
    end = num_around * (len(rings) - 1)
    triangles = [
        np.stack([first, here, onward], axis=-1),
        np.stack([a, c, b], axis=-1).reshape(-1, 3),
        np.stack([b, c, d], axis=-1).reshape(-1, 3),
        np.stack([last, end + onward, end + here], axis=-1),
    ]
    return Mesh(vertices, np.concatenate(triangles))


def perforated_plate(
    widths_mm: list[float], depth_mm: float, thickness_mm: float, hole_radius_mm: float, steps: int
) -> Mesh:
    """A plate of cells in a row, each with a round hole through its middle.

    Parameters
    ----------
    widths_mm
        Of the cells, along x; the first begins at 0.
    depth_mm, thickness_mm : float
        Along y and z, from 0.
    hole_radius_mm : float
    steps : int
        Vertices on a quarter of each hole, and on each side of a cell.

    Raises
    ------
    ValueError
        If a hole does not fit into its cell.
    """
    if 2 * hole_radius_mm >= min(*widths_mm, depth_mm):
        raise ValueError(f"holes of {2 * hole_radius_mm:g} mm in cells of {min(widths_mm):g} mm")
    parts = []
    start = 0.0
    for at, width in enumerate(widths_mm):
        ends = (at == 0, at == len(widths_mm) - 1)
        cell = _cell(width, depth_mm, thickness_mm, hole_radius_mm, steps, ends)
        parts.append(cell + np.array([start, 0, 0]))
        start += width
    return _welded(np.concatenate(parts))


def _cell(
    width: float, depth: float, thickness: float, radius: float, steps: int, ends: tuple[bool, bool]
) -> Float:
    """Corners of a cell's triangles, shape (n, 3, 3), without the sides where others join on."""
    share = np.arange(steps) / steps
    zero, one = np.zeros(steps), np.ones(steps)
    # From the corner at the origin's side, counterclockwise: below, right, above, left.
    square = np.concatenate(
        [
            np.stack([share, zero], 1),
            np.stack([one, share], 1),
            np.stack([1 - share, one], 1),
            np.stack([zero, 1 - share], 1),
        ]
    ) * (width, depth)
    angle = 2 * np.pi * np.arange(4 * steps) / (4 * steps) - 0.75 * np.pi
    circle = np.stack([np.cos(angle), np.sin(angle)], 1) * radius + (width / 2, depth / 2)
    on, off = np.arange(4 * steps), np.roll(np.arange(4 * steps), -1)

    def at(points: Float, z: float) -> Float:
        return np.column_stack([points, np.full(len(points), z)])

    def strip(outer: Float, inner: Float, which: npt.NDArray[np.int64]) -> Float:
        a, b = outer[on[which]], outer[off[which]]
        c, d = inner[on[which]], inner[off[which]]
        return np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])

    low, high = at(square, 0), at(square, thickness)
    hole_low, hole_high = at(circle, 0), at(circle, thickness)
    sides = np.ones(4 * steps, bool)
    sides[steps : 2 * steps] = ends[1]
    sides[3 * steps :] = ends[0]
    return np.concatenate(
        [
            strip(high, hole_high, on),
            strip(hole_low, low, on),
            strip(hole_high, hole_low, on),
            strip(low, high, on[sides]),
        ]
    )


def _welded(corners: Float) -> Mesh:
    """A mesh of triangles' corners, shape (n, 3, 3), with each vertex once."""
    points = np.round(corners.reshape(-1, 3), 6)
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    return Mesh(vertices, index.reshape(-1, 3))


def stl_bytes(mesh: Mesh, title: str) -> bytes:
    """Return a binary STL; ``title`` goes into its header, as ASCII."""
    corners = mesh.vertices_mm[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    records = np.zeros(len(corners), _STL_RECORD)
    records["normal"], records["corners"] = normal, corners
    header = title.encode("ascii", "replace")[:_STL_HEADER_BYTES].ljust(_STL_HEADER_BYTES)
    return header + len(corners).to_bytes(4, "little") + records.tobytes()


def threemf_bytes(mesh: Mesh, title: str) -> bytes:
    """Return a 3MF package with one object; the same mesh makes the same bytes."""
    vertices = "".join(
        f'<vertex x="{x:.6f}" y="{y:.6f}" z="{z:.6f}"/>\n' for x, y, z in mesh.vertices_mm.tolist()
    )
    triangles = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in mesh.triangles.tolist()
    )
    model = (
        '<?xml version="1.0" encoding="UTF-8"?>\n<model unit="millimeter" xml:lang="en-US" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">\n'
        f'<metadata name="Title">{_escaped(title)}</metadata>\n'
        f'<resources><object id="1" type="model" name="{_escaped(title)}"><mesh>\n'
        f"<vertices>\n{vertices}</vertices>\n<triangles>\n{triangles}</triangles>\n"
        '</mesh></object></resources>\n<build><item objectid="1"/></build>\n</model>\n'
    )
    package = io.BytesIO()
    with zipfile.ZipFile(package, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, text in (
            ("[Content_Types].xml", _CONTENT_TYPES),
            ("_rels/.rels", _RELATIONSHIPS),
            ("3D/3dmodel.model", model),
        ):
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, text)
    return package.getvalue()


def _escaped(text: str) -> str:
    for character, name in (("&", "amp"), ("<", "lt"), (">", "gt"), ('"', "quot")):
        text = text.replace(character, f"&{name};")
    return text
