"""Draw the printable landmark.

``python docs/plots/landmark_mesh.py`` writes docs/img/landmark.png.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from ertis_simulator.mesh import Mesh
from ertis_simulator.printing import Mount, landmark_mesh, landmark_profile

Float = npt.NDArray[np.float64]
RADIUS_MM = 48.0
LIGHT = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])


def turned(points: Float, pitch_deg: float) -> Float:
    """Points as seen from ``pitch_deg`` above the dish's opening plane; depth last."""
    pitch = np.deg2rad(pitch_deg)
    x, y, z = points.T
    up = z * np.cos(pitch) + y * np.sin(pitch)
    return np.column_stack([x, up, z * np.sin(pitch) - y * np.cos(pitch)])


def shade(axes: Any, mesh: Mesh, pitch_deg: float, title: str) -> None:
    """Paint the triangles that face the viewer, farthest first."""
    corners = turned(mesh.vertices_mm, pitch_deg)[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    front = normal[:, 2] > 0
    order = np.argsort(corners[front][:, :, 2].mean(axis=1))
    bright = 0.25 + 0.7 * np.clip(normal[front][order] @ LIGHT, 0, 1)
    colors = np.column_stack([bright * 0.85, bright * 0.9, bright])
    axes.add_collection(
        PolyCollection(
            corners[front][order][:, :, :2],
            facecolors=colors,
            edgecolors=colors,
            lw=0.4,
            antialiased=False,
        )
    )
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()
    axes.set_title(title)


def main() -> None:
    """Write the picture."""
    mesh = landmark_mesh(RADIUS_MM)
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    front, section, back = figure.subplots(1, 3)
    shade(front, mesh, 50, "concave side: faces the sonar")
    shade(back, mesh, -35, "convex back with the boss for the mount")
    profile = landmark_profile(RADIUS_MM, Mount())
    for side in (-1, 1):
        section.fill(side * profile[:, 0], profile[:, 1], color="#8899aa")
    section.annotate("sonar", (0, 45), (0, 62), ha="center", arrowprops={"arrowstyle": "<-"})
    section.set_ylim(-20, 70)
    section.set_aspect("equal")
    section.set_xlabel("mm")
    section.set_ylabel("z (mm)")
    section.set_title(f"section, r{RADIUS_MM:g}")
    figure.savefig(Path(__file__).parents[1] / "img" / "landmark.png", dpi=110)


if __name__ == "__main__":
    main()
