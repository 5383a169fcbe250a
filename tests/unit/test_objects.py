"""Named things against the formulas of their shapes, and against walls where both are the same."""

import numpy as np
import pytest

from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.landmark import Dish
from ertis_simulator.objects import (
    SIZES,
    DishObject,
    draw_sizes,
    make_thing,
    rod,
    stand_for,
)
from ertis_simulator.path import Path, Pose
from ertis_simulator.points import REFERENCE_K
from ertis_simulator.room import Room

EMITTER, MICS = np.array(EMITTER_POSITION_M), mic_positions_m()
POSE = Pose((0.0, 0.0, 1.0), 0.0)
RNG = np.random.default_rng(1)


def thing(kind, range_m=2.0, facing_deg=180.0, **sizes):
    full = draw_sizes(kind, sizes, np.random.default_rng(2))
    return make_thing(kind, range_m, 0.0, np.deg2rad(facing_deg), full, np.random.default_rng(3))


def echoes(made, pose=POSE):
    return made.clutter.echoes(pose, EMITTER, MICS)


def strength(part, k=REFERENCE_K):
    """Mean amplitude over the microphones, shape (num_echoes,)."""
    return np.abs(part.gain).mean(axis=1) * k**part.exponent


def test_a_pipe_answers_from_its_front_as_strongly_as_a_cylinder_does():
    (pipe,) = echoes(thing("pipe", 2.0, radius_m=0.05, base_m=0.0, top_m=2.0))
    assert pipe.path_m.mean() / 2 == pytest.approx(2.0 - 0.05, abs=2e-3)
    by_formula = 2.0 / 2 * np.sqrt(0.05 / 2.05) / 2.0**2
    assert strength(pipe)[0] == pytest.approx(by_formula, rel=0.01)
    assert pipe.exponent[0] == 0.0


def test_a_pipe_that_ends_below_the_sonar_answers_weakly_from_its_end():
    (whole,) = echoes(thing("pipe", radius_m=0.02, base_m=0.0, top_m=2.0))
    (short,) = echoes(thing("pipe", radius_m=0.02, base_m=0.0, top_m=0.5))
    assert strength(short)[0] < strength(whole)[0] / 5
    assert short.path_m.mean() / 2 == pytest.approx(np.hypot(2.0, 0.5), abs=0.04)


def test_an_edge_is_weaker_than_any_pipe_and_weaker_at_high_frequency():
    (edge,) = echoes(thing("edge", base_m=0.0, top_m=2.0))
    (pipe,) = echoes(thing("pipe", radius_m=0.008, base_m=0.0, top_m=2.0))
    assert strength(edge)[0] < strength(pipe)[0] / 3
    assert strength(edge, 2 * REFERENCE_K)[0] == pytest.approx(strength(edge)[0] / np.sqrt(2))


def test_the_face_of_a_huge_box_sounds_like_a_wall_there():
    box = thing("box", 2.5, width_m=50.0, depth_m=1.0, base_m=-50.0, top_m=50.0)
    face = box.clutter.panels.echoes(POSE, EMITTER, MICS)
    room = Room((-np.inf, 2.0), (-np.inf, np.inf), 0.8, floor_reflection=0.0)
    wall = room.echoes(POSE.to_sensor, POSE.turn, EMITTER, MICS)[0]
    front = np.argmax(np.abs(face.gain).max(axis=1))
    assert face.path_m[front] == pytest.approx(wall.path_m[0], abs=1e-6)
    assert face.gain[front] == pytest.approx(wall.gain[0], rel=1e-6)
    assert np.abs(np.delete(face.gain, front, axis=0)).max() < 1e-6


def test_a_box_turned_away_shows_its_edges_only():
    sizes = {"width_m": 0.4, "depth_m": 0.4, "base_m": 0.0, "top_m": 2.0}
    frontal, turned = (thing("box", facing_deg=deg, **sizes) for deg in (180.0, 150.0))
    faces = [
        strength(part.clutter.panels.echoes(POSE, EMITTER, MICS)) for part in (frontal, turned)
    ]
    assert faces[0].max() == pytest.approx(0.8 / 3.6, rel=0.05)
    assert faces[1].max() < 1e-4
    edges = strength(turned.clutter.lines.echoes(POSE, EMITTER, MICS))
    assert 1e-4 < edges.max() < faces[0].max() / 10


@pytest.mark.parametrize(
    ("kind", "factor"), [("trihedral", 1 / np.sqrt(3)), ("dihedral", np.sqrt(2))]
)
def test_a_corner_has_the_cross_section_that_radar_gives_it(kind, factor):
    (corner,) = echoes(thing(kind, side_m=0.05, height_m=1.0))
    length = factor * 0.05**2 * REFERENCE_K / (2 * np.pi)
    assert strength(corner)[0] == pytest.approx(length / 4, rel=0.02)
    assert strength(corner, 2 * REFERENCE_K)[0] == pytest.approx(2 * strength(corner)[0])


def test_a_corner_answers_over_forty_degrees_and_a_dihedral_only_level():
    def level(kind, facing_deg=180.0, height_m=1.0):
        (corner,) = echoes(thing(kind, facing_deg=facing_deg, side_m=0.05, height_m=height_m))
        return strength(corner)[0]

    for kind in ("trihedral", "dihedral"):
        half = level(kind, 200.0) / level(kind)
        assert half == pytest.approx(np.sqrt(0.5), abs=0.02)
    low = 1.0 - 2.0 * np.tan(np.deg2rad(10.0))
    assert level("trihedral", height_m=low) > 0.7 * level("trihedral")
    assert level("dihedral", height_m=low) < 0.3 * level("dihedral")


def test_a_bush_is_many_points_in_its_own_ball():
    bush = thing("bush", 3.0, radius_m=0.3, base_m=0.2, top_m=1.4)
    points = bush.clutter.points
    assert 12 <= len(points.lengths_m) <= 36
    assert set(points.exponents) <= {0.5, 1.0}
    spread = np.std(points.positions_m - [3.0, 0.0, 0.8], axis=0)
    assert spread == pytest.approx([0.15, 0.15, 0.3], rel=0.5)


def test_a_moving_thing_is_elsewhere_later():
    path = Path((0.0, 4.0), ((2.0, 0.0), (2.0, 4.0)), (0.0, 0.0))
    sizes = draw_sizes("pipe", {}, RNG)
    pipe = make_thing("pipe", 2.0, 0.0, 0.0, sizes, RNG, path)
    assert pipe.offset_m(0.0) == pytest.approx([0, 0, 0])
    assert pipe.offset_m(1.0) == pytest.approx([0, 1, 0])
    assert pipe.offset_m(99.0) == pytest.approx([0, 4, 0])


def test_a_stand_ends_where_its_dish_hides_it():
    dish = DishObject("r70", Dish.landmark(70), (2.0, 0.0, 1.0), (np.pi, 0.0))
    ends = stand_for(dish).clutter.lines.ends_m[0]
    assert ends[0, 2] == 0.0
    assert ends[1, 2] == pytest.approx(1.0 - 0.07)
    assert ends[1, 0] > 2.0  # behind the vertex
    assert rod(2.0, 0.0, 1.0).clutter.lines.ends_m[0, 1, 2] == 1.0


@pytest.mark.parametrize("kind", SIZES)
def test_sizes_are_drawn_within_their_ranges_and_given_ones_kept(kind):
    rng = np.random.default_rng(5)
    for _ in range(50):
        sizes = draw_sizes(kind, {}, rng)
        for name, (low, high) in SIZES[kind].items():
            scale = sizes["radius_m"] if kind in ("bowl", "lampshade") and name == "depth_m" else 1
            assert low <= sizes[name] / scale <= high
    name = next(iter(SIZES[kind]))
    assert draw_sizes(kind, {name: 0.123}, rng)[name] == 0.123
