"""A simulated scene as a picture: its plan from above beside what its first ping sounds like."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ertis_daemon.picture import new_figure, paint, save
from ertis_daemon.pipeline import build_scanner
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import Emission
from ertis_driver.device import Settings
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.scene import DishObject, Scene

PATH_PINGS = 100  # of the sonar's way, drawn if it moves
_AXIS_M = 0.25  # length of the stroke that shows where a dish looks


def draw_scene(scene: Scene, chirp: Emission, path: Path) -> None:
    """Draw a scene's first ping to a PNG, SVG or PDF file.

    Raises
    ------
    ErtisError
        If matplotlib is missing or the file cannot be written.
    """
    figure = new_figure(14.0, 6.0)
    plan, heard = figure.subplots(1, 2)
    _draw_plan(plan, scene)
    settings = Settings(chirp)
    words = scene.hear(0, settings.num_words, chirp.samples(AUDIO_RATE_HZ))
    scanner = build_scanner(settings, scene.air)
    paint(figure, heard, scanner.image(PdmDecoder().decode(words).audio)[1])
    truth = scene.truth(0)
    for item in truth["landmarks"] + truth["decoys"]:
        across = item["range_m"] * np.sin(item["azimuth_rad"])
        ahead = item["range_m"] * np.cos(item["azimuth_rad"])
        if abs(item["azimuth_rad"]) < np.pi / 2:
            heard.plot(across, ahead, "o", fillstyle="none", color=_colour(item), markersize=14)
            heard.annotate(
                item["label"], (across, ahead), (9, 9), textcoords="offset points", color="white"
            )
    heard.set_title("what ping 0 sounds like (simulated)")
    plan.set_title(f"{scene.name} (simulated): green visible, red not, orange decoy")
    save(figure, path)


def _colour(item: dict[str, Any]) -> str:
    if not item["label"].startswith("r"):
        return "orange"
    return "limegreen" if item["visible"] else "red"


def _draw_plan(axes: Any, scene: Scene) -> None:
    """World frame, x up and y to the left, as the sonar's picture beside it."""
    (x0, x1), (y0, y1) = scene.room.x_m, scene.room.y_m
    if np.isfinite([x0, x1, y0, y1]).all():
        axes.plot([y0, y1, y1, y0, y0], [x0, x0, x1, x1, x0], color="black", linewidth=2)
    points = scene.clutter.points.positions_m
    axes.plot(points[:, 1], points[:, 0], ".", color="silver", markersize=2, zorder=0)
    for thing in scene.things:
        _draw_thing(axes, thing)
    truth = scene.truth(0)
    said = {True: iter(truth["landmarks"]), False: iter(truth["decoys"])}
    for dish in scene.dishes:
        _draw_dish(axes, dish, next(said[dish.is_landmark]))
    _draw_sonar(axes, scene)
    axes.set_aspect("equal")
    axes.invert_xaxis()
    axes.set(xlabel="y (m)", ylabel="x (m)")


def _draw_thing(axes: Any, thing: Any) -> None:
    for blocker in thing.blockers:
        ring = np.vstack([blocker.corners_m, blocker.corners_m[:1]])
        axes.fill(ring[:, 1], ring[:, 0], color="tan", alpha=0.7)
    x, y, _ = thing.place_m
    axes.plot(y, x, "x", color="saddlebrown", markersize=4)
    axes.annotate(thing.kind, (y, x), (3, 3), textcoords="offset points", fontsize=6)
    if thing.path is not None:
        _draw_way(axes, [thing.path.at(t)[:2] for t in thing.path.times_s], "tan")


def _draw_dish(axes: Any, dish: DishObject, said: dict[str, Any]) -> None:
    x, y, _ = dish.vertex_m
    azimuth, colour = dish.facing_rad[0], _colour(said)
    ahead, aside = _AXIS_M * np.cos(azimuth), _AXIS_M * np.sin(azimuth)
    axes.annotate(
        "", (y + aside, x + ahead), (y, x), arrowprops={"arrowstyle": "->", "color": colour}
    )
    axes.plot(y, x, "o", color=colour)
    text = f"{dish.label}, {np.degrees(said['tilt_rad']):.0f} deg"
    axes.annotate(text, (y, x), (6, -10), textcoords="offset points", fontsize=8)
    if dish.path is not None:
        _draw_way(axes, [dish.path.at(t)[:2] for t in dish.path.times_s], colour)


def _draw_way(axes: Any, places: list[tuple[float, float]], colour: str) -> None:
    x, y = np.array(places).T
    axes.plot(y, x, ":", color=colour)


def _draw_sonar(axes: Any, scene: Scene) -> None:
    poses = [scene.pose(index) for index in range(PATH_PINGS)]
    x, y = np.array([pose.position_m[:2] for pose in poses]).T
    axes.plot(y, x, "-", color="blue", linewidth=1)
    yaw = poses[0].yaw_rad
    axes.annotate(
        "",
        (y[0] + 0.5 * np.sin(yaw), x[0] + 0.5 * np.cos(yaw)),
        (y[0], x[0]),
        arrowprops={"arrowstyle": "-|>", "color": "blue"},
    )
    axes.plot(y[0], x[0], "s", color="blue")
    axes.annotate("sonar", (y[0], x[0]), (6, -10), textcoords="offset points", fontsize=8)
