from importlib import resources

import numpy as np
import pytest

from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_simulator.dataset import RANGE_M, WIDE_AZIMUTH_RAD, random_scene
from ertis_simulator.errors import SceneError
from ertis_simulator.noise_sources import AirGun, OtherSonar, Tone
from ertis_simulator.objects import LIKE_A_LANDMARK
from ertis_simulator.scene_file import MAX_SCENE_BYTES, load_scene

CHIRP = DEFAULT_CHIRP.samples(450e3)
NUM_WORDS = 65_530  # a multiple of 10
LANDMARK = "landmarks: [{radius_mm: 48, x_m: 2.0, y_m: 0.0}]\n"


@pytest.fixture
def scene_file(tmp_path):
    def write(text):
        path = tmp_path / "hall.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.fixture(scope="module")
def demo():
    with resources.as_file(resources.files("ertis_simulator") / "scenes/demo.yaml") as path:
        return load_scene(path)


def refusal(path):
    """The one line that says why a scene file is refused; it names the file."""
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    message = str(caught.value)
    assert "\n" not in message
    assert path.name in message
    return message


def test_the_demo_holds_the_four_landmarks_in_sight(demo):
    assert [item.label for item in demo.dishes] == ["r35", "r48", "r58", "r70"]
    assert all(item.is_landmark for item in demo.dishes)
    told = demo.truth(0)["landmarks"]
    assert all(item["visible"] for item in told)
    assert told[0]["range_m"] == pytest.approx(np.hypot(1.55, 0.62), abs=1e-4)
    assert told[0]["azimuth_rad"] == pytest.approx(np.arctan2(0.62, 1.55), abs=1e-4)


def test_a_scene_in_degrees_is_a_scene_in_radians(scene_file):
    text = "sonar: {heading_deg: 90, turn_deg_s: 180, ping_period_s: 0.5, velocity_m_s: [1, 0]}\n"
    scene = load_scene(scene_file(text + LANDMARK))
    assert scene.start.yaw_rad == pytest.approx(np.pi / 2)
    assert scene.pose(1).yaw_rad == pytest.approx(np.pi)
    assert scene.pose(2).position_m == pytest.approx((1.0, 0.0, 0.5))
    assert scene.truth(0)["landmarks"][0]["azimuth_rad"] == pytest.approx(-np.pi / 2, abs=1e-4)
    assert scene.name == "hall"


def test_a_decoy_is_no_landmark(scene_file):
    text = "decoys: [{name: cup, radius_mm: 40, depth_mm: 80, x_m: 1, y_m: 0}]\n"
    scene = load_scene(scene_file(text))
    assert [(item.label, item.is_landmark) for item in scene.dishes] == [("cup", False)]
    assert scene.truth(0)["landmarks"] == []
    assert scene.truth(0)["decoys"][0]["label"] == "cup"


@pytest.mark.parametrize(
    ("text", "where", "nearest"),
    [
        ("landmark: []\n", "landmark", "landmarks"),
        ("room: {wall_reflexion: 0.5}\n", "room.wall_reflexion", "wall_reflection"),
        ("sonar: {heigth_m: 1}\n", "sonar.heigth_m", "height_m"),
        ("landmarks: [{radius: 48, x_m: 1, y_m: 0}]\n", "landmarks[0].radius", "radius_mm"),
        ("air: {temperature: 3}\n", "air.temperature", "temperature_c"),
        ("objects: [{kind: box, x_m: 1, y_m: 1, widht_m: 1}]\n", "objects[0].widht_m", "width_m"),
        ("noise: [{kind: tone, freqency_hz: 1}]\n", "noise[0].freqency_hz", "frequency_hz"),
        ("clutter_kinds: {bushes: 1}\n", "clutter_kinds.bushes", "bush"),
        ("sonar: {path: [{ts: 0}]}\n", "sonar.path[0].ts", "t_s"),
    ],
)
def test_an_unknown_key_names_the_nearest_known_one(scene_file, text, where, nearest):
    message = refusal(scene_file(text))
    assert f"{where}: unknown key, did you mean '{nearest}'?" in message


def test_an_unknown_key_like_no_other_lists_the_known_ones(scene_file):
    assert "known: " in refusal(scene_file("zzz: 1\n"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected a mapping"),
        ("- 1\n", "expected a mapping"),
        ("room: 3\n", "hall.yaml:1:7: room: met '3', expected a mapping"),
        ("sonar: {x_m: wide}\n", "sonar.x_m: met 'wide', expected a number"),
        ("sonar: {x_m: .nan}\n", "sonar.x_m: met '.nan', expected a number"),
        ("sonar: {x_m: true}\n", "sonar.x_m: met 'true', expected a number"),
        ("room: {x_m: [1]}\n", "room.x_m: met a list, expected two numbers"),
        ("room: {x_m: [1, a]}\n", "hall.yaml:1:17: room.x_m: met 'a', expected a number"),
        ("landmarks: 3\n", "landmarks: met '3', expected a list"),
        ("landmarks: [7]\n", "landmarks[0]: met '7', expected a mapping"),
        ("landmarks: [{radius_mm: 50, x_m: 1, y_m: 0}]\n", "expected one of 35, 48, 58, 70"),
        ("landmarks: [{x_m: 1, y_m: 0}]\n", "hall.yaml:1:13: landmarks[0].radius_mm: missing"),
        ("decoys: [{radius_mm: 50, depth_mm: 200, x_m: 1, y_m: 0}]\n", "decoys[0].depth_mm"),
        ("decoys: [{radius_mm: 0, x_m: 1, y_m: 0}]\n", "decoys[0]"),
        ("decoys: [{radius_mm: -5, depth_mm: 2, x_m: 1, y_m: 0}]\n", "decoys[0]"),
        ("clutter_per_m2: -1\n", "clutter_per_m2"),
        ("clutter_per_m2: 1.0e+14\n", "clutter_per_m2"),
        ("landmarks: [{radius_mm: 48, x_m: 1, y_m: 0, rim_strength: 2}]\n", "expected 0 to 1"),
        ("seed: -1\n", "seed"),
        ("room: {x_m: [5, -2]}\nclutter_per_m2: 1\n", "room.x_m"),
        ("air: {temperature_c: -400}\n", "air.temperature_c"),
        ("sonar: {ping_period_s: -1}\n", "sonar.ping_period_s"),
        ("seed: 1\nseed: 2\n", "hall.yaml:2:1: seed: given twice, first in line 1"),
        ("seed: 1:30\n", "seed: met '1:30', expected a number"),
        ("seed: &a 1\nname: *a\n", "aliases are not allowed"),
        ("dead_microphones: [32]\n", "met 32, expected whole numbers from 0 to 31"),
        ("dead_microphones: [1.5]\n", "met 1.5, expected whole numbers"),
        ("stands: maybe\n", "stands: met 'maybe', expected one of true, false"),
        ("room: {diffuse: 2}\n", "room.diffuse: met 2, expected 0 to 1"),
        ("objects: [{x_m: 1, y_m: 1}]\n", "objects[0].kind: missing, expected one of pipe"),
        ("objects: [{kind: bushh, x_m: 1, y_m: 1}]\n", "met 'bushh', did you mean 'bush'?"),
        ("objects: [{kind: pipe, x_m: 1, y_m: 1, width_m: 1}]\n", "a pipe has none, its sizes"),
        ("objects: [{kind: pipe, x_m: 1, y_m: 1, base_m: 3, top_m: 2}]\n", "above the base"),
        ("objects: [{kind: bowl, x_m: 1, y_m: 1, radius_mm: 9, depth_mm: 50}]\n", "twice the"),
        ("sonar: {x_m: 1, path: [{t_s: 0, x_m: 1, y_m: 1}]}\n", "sonar.x_m: met beside path"),
        ("sonar: {path: []}\n", "sonar.path: met no waypoint"),
        (
            "sonar: {path: [{t_s: 1, x_m: 0, y_m: 0}, {t_s: 1, x_m: 1, y_m: 0}]}\n",
            "sonar.path[1].t_s: met 1 after 1, expected rising times",
        ),
        ("noise: [{kind: tone, level_dbfs: -60}]\n", "noise[0].frequency_hz: missing"),
        ("noise: [{kind: tone, level_dbfs: 6, frequency_hz: 1}]\n", "noise[0].level_dbfs"),
        ("noise: [{kind: tone, per_s: 6}]\n", "noise[0].per_s: belongs to air_gun, met in tone"),
        ("noise: [{kind: sonar, level_dbfs: -60, chirp: up}]\n", "noise[0].chirp"),
        ("clutter_kinds: {bush: 0}\n", "clutter_kinds: met no share above 0"),
        ("a: [1\n", "not YAML"),
        ("a: \tb\n", "not YAML"),
        (b"\xff\xfe\x00", "is not text"),
        ("x" * (MAX_SCENE_BYTES + 1), "larger than"),
    ],
)
def test_each_kind_of_bad_file_is_refused_in_one_clear_line(scene_file, text, told):
    assert told in refusal(scene_file(text))


WALLS = "between the walls"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "room: {x_m: [-1, 2]}\nlandmarks: [{radius_mm: 48, x_m: 2.5, y_m: 0}]\n",
            f"hall.yaml:2:34: landmarks[0].x_m: met 2.5, expected -1 to 2, {WALLS} (room.x_m)",
        ),
        ("landmarks: [{radius_mm: 48, x_m: 2, y_m: 9}]\n", "landmarks[0].y_m: met 9, expected -3"),
        ("decoys: [{radius_mm: 50, x_m: -9, y_m: 0}]\n", "decoys[0].x_m: met -9, expected -2 to"),
        ("objects: [{kind: bowl, x_m: 6, y_m: 0}]\n", "objects[0].x_m: met 6, expected -2 to 5"),
        ("objects: [{kind: pipe, x_m: 6, y_m: 0}]\n", "objects[0].x_m: met 6, expected -2 to 5"),
        (
            "landmarks: [{radius_mm: 48, x_m: 2, y_m: 0, height_m: -0.1}]\n",
            "hall.yaml:1:55: landmarks[0].height_m: met -0.1, expected 0 to 100",
        ),
        ("sonar: {x_m: 9}\n", f"hall.yaml:1:14: sonar.x_m: met 9, expected -2 to 5, {WALLS}"),
        ("seed: 1\nroom: {x_m: [1, 5]}\n", "hall.yaml:2:13: room.x_m: met 1 to 5, without 0"),
        ("sonar: {height_m: 1}\nroom: {y_m: [1, 5]}\n", "hall.yaml:1:8: sonar.y_m: met 0, expe"),
        (
            "sonar: {path: [{t_s: 0, x_m: 0, y_m: 0}, {t_s: 1, x_m: 0, y_m: 4}]}\n",
            "hall.yaml:1:64: sonar.path[1].y_m: met 4, expected -3 to 3",
        ),
        (
            "landmarks:\n  - {radius_mm: 48, x_m: 4, y_m: 0,\n"
            "     path: [{t_s: 0, x_m: 0, y_m: 0}, {t_s: 1, x_m: 2, y_m: 0}]}\n",
            "hall.yaml:3:53: landmarks[0].path[1].x_m: met 6, expected -2 to 5",
        ),
        (
            "sonar: {x_m: 1, height_m: 0.5}\nlandmarks: [{radius_mm: 48, x_m: 1, y_m: 0}]\n",
            "hall.yaml:2:34: landmarks[0].x_m: met 0 m from the sonar, expected 0.05 at least",
        ),
    ],
)
def test_what_cannot_be_there_is_refused_where_the_file_says_it(scene_file, text, told):
    assert told in refusal(scene_file(text))


def test_what_touches_a_wall_or_the_floor_is_in_the_room(scene_file):
    scene = load_scene(scene_file("landmarks: [{radius_mm: 48, x_m: 5, y_m: -3, height_m: 0}]\n"))
    assert scene.dishes[0].vertex_m == (5.0, -3.0, 0.0)


def test_deep_nesting_is_refused_too(scene_file):
    refusal(scene_file("[" * 30_000))


def test_an_absent_file_is_refused(tmp_path):
    assert "No such file" in refusal(tmp_path / "none.yaml")


def test_the_same_ping_of_a_scene_is_the_same_to_the_last_bit(demo):
    once, again = (demo.hear(3, NUM_WORDS, CHIRP) for _ in range(2))
    assert once.dtype == np.uint32
    assert once.shape == (NUM_WORDS,)
    np.testing.assert_array_equal(once, again)


def test_even_where_nothing_moves_no_two_pings_are_the_same(scene_file):
    still = load_scene(scene_file(LANDMARK))
    assert still.truth(0)["landmarks"] == still.truth(1)["landmarks"]
    assert np.mean(still.hear(0, NUM_WORDS, CHIRP) != still.hear(1, NUM_WORDS, CHIRP)) > 0.9


@pytest.mark.parametrize("num_words", [32_768, 65_536, 163_840])
def test_a_scene_is_heard_for_as_many_words_as_the_firmware_would_send(demo, num_words):
    assert demo.hear(0, num_words, CHIRP).shape == (num_words,)


def test_another_ping_sounds_different(demo):
    once, other = demo.hear(3, NUM_WORDS, CHIRP), demo.hear(4, NUM_WORDS, CHIRP)
    assert np.mean(once != other) > 0.9


def test_a_random_scene_is_the_same_for_the_same_number():
    once, again, other = random_scene(1, 5), random_scene(1, 5), random_scene(1, 6)
    assert once.dishes == again.dishes
    assert once.room == again.room
    np.testing.assert_array_equal(once.clutter.points.positions_m, again.clutter.points.positions_m)
    np.testing.assert_array_equal(once.hear(0, 32_760, CHIRP), again.hear(0, 32_760, CHIRP))
    assert once.room != other.room
    assert once.room != random_scene(2, 5).room


def test_random_scenes_hold_landmarks_within_reach_and_decoys_of_other_shapes():
    scenes = [random_scene(3, number) for number in range(120)]
    with_landmarks = [any(item.is_landmark for item in scene.dishes) for scene in scenes]
    assert 0.6 < np.mean(with_landmarks) < 0.9
    for scene in scenes:
        for item in scene.dishes:
            x, y, _ = item.vertex_m
            assert RANGE_M[0] <= np.hypot(x, y) <= RANGE_M[1]
            assert abs(np.arctan2(y, x)) <= WIDE_AZIMUTH_RAD
            assert scene.room.x_m[0] < x < scene.room.x_m[1]
            assert scene.room.y_m[0] < y < scene.room.y_m[1]
            ratio = item.dish.depth_m / item.dish.aperture_radius_m
            assert (abs(ratio - 0.6) < 1e-9) == item.is_landmark
            assert item.is_landmark or abs(ratio - 0.6) > LIKE_A_LANDMARK


def test_random_scenes_hold_every_kind_of_thing_and_of_noise():
    scenes = [random_scene(4, number) for number in range(120)]
    kinds = {thing.kind for scene in scenes for thing in scene.things}
    assert kinds == {"pipe", "edge", "box", "bush", "dihedral", "trihedral"}
    noises = {type(source) for scene in scenes for source in scene.noise}
    assert noises == {Tone, AirGun, OtherSonar}
    decoys = {i.label for scene in scenes for i in scene.dishes if not i.is_landmark}
    assert decoys == {"bowl", "lampshade"}


def test_the_office_that_ships_has_one_landmark_of_three_behind_a_box():
    with resources.as_file(resources.files("ertis_simulator") / "scenes/office.yaml") as path:
        scene = load_scene(path)
    told = {item["label"]: item for item in scene.truth(0)["landmarks"]}
    assert {label: item["shadowed"] for label, item in told.items()} == {
        "r48": False,
        "r70": False,
        "r58": True,
    }
    assert not told["r58"]["visible"]
    assert told["r48"]["visible"]


def test_objects_noise_path_and_dead_microphones_are_read(scene_file):
    scene = load_scene(
        scene_file(
            "dead_microphones: [3, 17, 3]\n"
            "stands: true\n"
            "room: {wall_roughness_mm: 2, diffuse: 0.1}\n"
            "sonar: {path: [{t_s: 0, x_m: 0, y_m: 0, heading_deg: 0}, "
            "{t_s: 2, x_m: 1, y_m: 0, heading_deg: 90}], ping_period_s: 0.5}\n"
            "objects:\n"
            "  - {kind: pipe, x_m: 2, y_m: 1, radius_mm: 30, top_m: 1.2}\n"
            "  - {kind: bowl, x_m: 2, y_m: 0, radius_mm: 50, depth_mm: 20}\n"
            "noise:\n"
            "  - {kind: air_gun, level_dbfs: -50, azimuth_deg: 90}\n"
        )
    )
    assert scene.dead_mics == (3, 17)
    assert scene.stands
    assert (scene.room.wall_roughness_m, scene.room.diffuse) == (2e-3, 0.1)
    assert scene.pose(2).position_m == pytest.approx((0.5, 0.0, 0.5))
    assert scene.pose(2).yaw_rad == pytest.approx(np.pi / 4)
    assert scene.pose(99).position_m == pytest.approx((1.0, 0.0, 0.5))
    assert [thing.kind for thing in scene.things] == ["pipe"]
    assert scene.things[0].clutter.lines.radius_m == pytest.approx([0.03])
    assert [(dish.label, dish.is_landmark) for dish in scene.dishes] == [("bowl", False)]
    assert scene.dishes[0].dish.depth_m == pytest.approx(0.02)
    assert scene.noise == (AirGun(-50.0, azimuth_rad=np.pi / 2),)


def test_a_calibrated_response_beside_the_scene_replaces_the_shipped_one(scene_file, tmp_path):
    (tmp_path / "mine.csv").write_text("frequency_hz,level_db\n20000,-20\n80000,-20\n")
    text = "seed: 3\nroom: {floor_reflection: 0, diffuse: 0}\n" + LANDMARK
    mine = load_scene(scene_file(text + "sensor_response: mine.csv\n"))
    assert mine.sensor.amplitude(np.array([30e3, 50e3])) == pytest.approx(0.1)
    shipped = load_scene(scene_file(text))
    assert shipped.sensor.amplitude(np.array(50e3)) == pytest.approx(1.0)
    sounds = [PdmDecoder().decode(made.hear(0, NUM_WORDS, CHIRP)).audio for made in (mine, shipped)]
    quiet, loud = (float(np.std(audio[:, 100:900])) for audio in sounds)
    assert quiet < loud / 2


def test_a_softly_tapered_rim_is_heard_less_in_the_scene(scene_file):
    turned = "{radius_mm: 48, x_m: 2, y_m: 0, facing_deg: 95, rim_strength: %g}"
    sharp, tapered = (
        load_scene(scene_file(f"landmarks: [{turned % strength}]\n")) for strength in (1.0, 0.0)
    )
    k = 2 * np.pi * np.linspace(30e3, 70e3, 200) / 343.0
    loud, quiet = (
        np.linalg.norm(made.own_echoes(made.dishes[0], 0).responses[0].body.spectrum(k))
        for made in (sharp, tapered)
    )
    assert quiet < 0.7 * loud


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (None, "No such file"),
        ("20000,-20\n10000,0\n", "mine.csv:2: met 10000 Hz after 20000"),
        (b"\xff\xfe\x00", "is not text"),
    ],
)
def test_a_bad_response_is_told_with_both_places(scene_file, tmp_path, content, told):
    if content is not None:
        content = content if isinstance(content, bytes) else content.encode()
        (tmp_path / "mine.csv").write_bytes(content)
    message = refusal(scene_file("seed: 3\nsensor_response: mine.csv\n"))
    assert "hall.yaml:2:18: sensor_response: " in message
    assert told in message


@pytest.mark.parametrize("kind", ["bowl", "lampshade"])
def test_a_dish_of_any_given_size_gets_the_rest_drawn(scene_file, kind):
    for given in ("radius_mm: 3", "depth_mm: 300", "height_m: 1"):
        text = f"objects: [{{kind: {kind}, x_m: 1, y_m: 0, {given}}}]\n"
        dish = load_scene(scene_file(text)).dishes[0].dish
        assert 0 < dish.depth_m <= 2 * dish.aperture_radius_m
