from pathlib import Path

import numpy as np
import pytest

from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.clutter import CLUSTER_KINDS
from ertis_simulator.environments import ENVIRONMENTS, draw_place
from ertis_simulator.objects import SIZES
from ertis_simulator.path import Pose


def place(name, seed=1):
    return draw_place(ENVIRONMENTS[name], np.random.default_rng(seed))


def test_there_are_seven_from_open_lab_to_packed_garage():
    names = list(ENVIRONMENTS)
    assert len(names) == 7
    assert (names[0], names[-1]) == ("open_lab", "packed_garage")
    ends = (
        ENVIRONMENTS["open_lab"].clutter_per_m2[0],
        ENVIRONMENTS["packed_garage"].clutter_per_m2[1],
    )
    assert ends == (0.5, 8.0)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_place_is_drawn_within_its_environment(name):
    environment = ENVIRONMENTS[name]
    for seed in range(20):
        made = place(name, seed)
        low, high = environment.length_m
        assert low <= made.room.x_m[1] - made.room.x_m[0] <= high
        low, high = environment.width_m
        assert low <= made.room.y_m[1] - made.room.y_m[0] <= high
        low, high = environment.temperature_c
        assert low <= made.air.temperature_c <= high
        assert {thing.kind for thing in made.things} <= set(environment.furniture_per_m2)
        for thing in made.things:
            assert made.room.x_m[0] <= thing.place_m[0] <= made.room.x_m[1]
            assert made.room.y_m[0] <= thing.place_m[1] <= made.room.y_m[1]


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_environments_speak_of_known_things_only(name):
    environment = ENVIRONMENTS[name]
    assert set(environment.kinds) <= set(CLUSTER_KINDS)
    assert set(environment.furniture_per_m2) <= set(SIZES)


def test_the_same_seed_furnishes_the_same_place_and_another_another():
    once, again, other = place("office", 1), place("office", 1), place("office", 2)
    assert once.room == again.room
    np.testing.assert_array_equal(once.clutter.points.positions_m, again.clutter.points.positions_m)
    assert once.noise == again.noise
    assert once.room != other.room


def test_clutter_returns_more_from_a_packed_garage_than_from_an_open_lab():
    def energy_db(name):
        total = []
        for seed in range(10):
            made = place(name, seed)
            pose = Pose((0.6, float(np.mean(made.room.y_m)), 0.8), 0.0)
            emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
            echoes = made.clutter.points.echoes(pose, emitter, mics)
            ahead = (echoes.path_m[:, 0] > 2) & (echoes.path_m[:, 0] < 8)
            k = 2 * np.pi * 50e3 / 343.0
            total.append(np.sum((echoes.gain[ahead, 0] * k ** echoes.exponent[ahead]) ** 2))
        return 10 * np.log10(np.mean(total))

    assert energy_db("packed_garage") > energy_db("open_lab") + 6


def test_a_workshop_is_mostly_noisy_and_an_open_lab_mostly_quiet():
    def share(name):
        return np.mean([bool(place(name, seed).noise) for seed in range(60)])

    assert share("workshop") > 0.7
    assert share("open_lab") < 0.3


def span(limits, scale=1.0):
    return f"{limits[0] * scale:g}-{limits[1] * scale:g}"


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_page_gives_the_figures_of_the_code(name):
    one = ENVIRONMENTS[name]
    page = (Path(__file__).parents[2] / "docs/environments.md").read_text()
    furniture = ", ".join(f"{kind} {share:g}" for kind, share in one.furniture_per_m2.items())
    assert f"| `{name}` | {span(one.width_m)} x {span(one.length_m)} | " in page
    assert f" | {span(one.clutter_per_m2)} | " in page
    assert f" | {furniture} |\n" in page
    noise = (one.machine_probability, one.air_gun_probability, one.sonar_probability)
    assert (
        f"| `{name}` | {span(one.wall_reflection)}, {span(one.wall_roughness_m, 1e3)} | "
        f"{span(one.floor_reflection)}, {span(one.floor_roughness_m, 1e3)} | {span(one.diffuse)} | "
        f"{span(one.temperature_c)}, {span(one.humidity_percent)} | "
        f"{' / '.join(f'{share:g}' for share in noise)} |\n"
    ) in page
