"""The commands that make and read recordings: simulate, detect."""

import json

import numpy as np
import pytest

from ertis_daemon.chirp_guess import guess_chirp
from ertis_daemon.cli import main
from ertis_daemon.pipeline import build_scanner
from ertis_detector.air import Air
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.errors import SettingsError
from ertis_driver.recording import open_recording
from ertis_simulator.dataset import random_scene

SCENE = """\
seed: 3
room: {x_m: [-1.0, 6.0], y_m: [-3.0, 3.0]}
landmarks:
  - {radius_mm: 70, x_m: 2.0, y_m: 0.2, height_m: 0.5, facing_deg: 185}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    (folder / "room.yaml").write_text(SCENE)
    path = folder / "room.mcap"
    assert main(["simulate", str(folder / "room.yaml"), "-n", "2", "-o", str(path)]) == 0
    return path


def error_of(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_sound_at_the_audible_clock_is_no_food_for_the_detector():
    with pytest.raises(SettingsError, match="detection needs 4500000"):
        build_scanner(Settings(pdm_rate_hz=1_125_000), Air())


def test_detect_takes_the_air_of_each_ping(tmp_path, capsys):
    """One landmark heard at -5, 35, and moist 35 C: its echo comes 7 and 8 % earlier."""
    from ertis_detector.air import Air
    from ertis_driver.frame import PdmFrame
    from ertis_driver.recording import RecordingInfo, RecordingWriter
    from ertis_simulator.landmark import Dish
    from ertis_simulator.room import Room
    from ertis_simulator.scene import DishObject, Pose, Scene

    room = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)
    dish = DishObject("r58", Dish.landmark(58), (2.0, 0.0, 0.6), (np.pi, 0.0))
    path = tmp_path / "air.mcap"
    with RecordingWriter(path, RecordingInfo("sim", DEFAULT_CHIRP, 163_840)) as writer:
        for index, (degrees, percent) in enumerate(((-5.0, 50.0), (35.0, 10.0), (35.0, 90.0))):
            air = Air(degrees, percent)
            scene = Scene(room, Pose((0.0, 0.0, 0.6), 0.0), (dish,), air=air)
            words = scene.hear(index, 163_840, DEFAULT_CHIRP.samples(450e3))
            writer.write(PdmFrame(words, index, 0), temperature_c=degrees, humidity_percent=percent)
    assert main(["detect", str(path), "--json", "--min-probability", "0.5"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for line in lines:
        assert [one["class"] for one in line["landmarks"]] == ["r58"]
        assert line["landmarks"][0]["range_m"] == pytest.approx(2.0, abs=0.005)
        assert line["landmarks"][0]["state"] == "new"  # every ping by itself


@pytest.mark.parametrize("wrong", ["7", "-0.1", "nan"])
def test_a_probability_that_is_none_is_one_clear_line(recording, wrong, capsys):
    assert main(["detect", str(recording), f"--min-probability={wrong}"]) == 1
    assert f"--min-probability {wrong}, expected 0 to 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flag", "expected"), [("--temperature-c", "-60 to 80"), ("--humidity-percent", "0 to 100")]
)
@pytest.mark.parametrize("wrong", ["nan", "inf", "2000", "-300"])
def test_air_that_is_none_is_one_clear_line(recording, flag, expected, wrong, capsys):
    assert main(["detect", str(recording), f"{flag}={wrong}"]) == 1
    assert error_of(capsys) == f"ertis: {flag} {wrong}, expected {expected}"


def test_a_simulated_recording_says_so_and_holds_its_truth(recording):
    opened = open_recording(recording)
    assert opened.info.source == "sim"
    truths = [ping.truth for ping in opened]
    assert [truth["landmarks"][0]["label"] for truth in truths] == ["r70", "r70"]


def test_detect_prints_one_object_a_ping_with_the_landmark_and_the_echoes(recording, capsys):
    assert main(["detect", str(recording), "--json", "--reflectors", "3"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["ping_index"] for line in lines] == [0, 1]
    for line in lines:
        assert line["source"] == "sim"
        assert len(line["reflectors"]) == 3
        at = min(line["reflectors"], key=lambda spot: abs(spot["range_m"] - 2.04))
        assert at["range_m"] == pytest.approx(2.04, abs=0.02)
        assert at["azimuth_rad"] == pytest.approx(0.0997, abs=0.02)
        assert set(at) == {"range_m", "azimuth_rad", "elevation_rad", "level_db"}
        levels = [spot["level_db"] for spot in line["reflectors"]]
        assert levels == sorted(levels, reverse=True)


def test_detect_draws_a_picture(recording, tmp_path, capsys):
    picture = tmp_path / "ping.png"
    assert main(["detect", str(recording), "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out.count("[sim]") == 2


def test_a_folder_named_for_a_picture_makes_no_file_beside_it(recording, tmp_path, capsys):
    folder, scene = tmp_path / "pictures", recording.with_suffix(".yaml")
    folder.mkdir()
    for argv in (["detect", recording], ["simulate", scene], ["dataset", "stats", tmp_path]):
        assert main([*map(str, argv), "--plot", str(folder)]) == 1
        said = error_of(capsys)
        assert said == f"ertis: cannot write {folder}: name a file in a folder that exists"
    assert list(tmp_path.iterdir()) == [folder]


def test_a_number_of_reflectors_is_not_negative(recording, capsys):
    assert main(["detect", str(recording), "--reflectors", "-1"]) == 1
    assert error_of(capsys) == "ertis: --reflectors -1, expected 0 or more"


def test_a_raw_file_is_read_by_the_chirp_heard_in_it(tmp_path, capsys):
    path = tmp_path / "ping.bin"
    random_scene(5, 1).hear(0, 163_840, INCUMBENT_CHIRP.samples(450e3)).tofile(path)
    assert main(["detect", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["chirp"] == INCUMBENT_CHIRP.name


@pytest.mark.parametrize("chirp", [DEFAULT_CHIRP, INCUMBENT_CHIRP, None])
def test_the_direct_path_tells_the_chirp(chirp):
    words = random_scene(5, 2).hear(0, 163_840, chirp.samples(450e3) if chirp else None)
    assert guess_chirp(PdmDecoder().decode(words).audio) == chirp


def test_a_chirp_without_a_model_is_refused_in_one_line(tmp_path, capsys):
    path = tmp_path / "ping.bin"
    np.zeros(163_840, "<u4").tofile(path)
    assert main(["detect", str(path), "--chirp", "linear:90000:30000:0.001"]) == 1
    assert "no model ships for chirp linear:90000:30000:0.001" in error_of(capsys)


def test_a_model_for_another_chirp_is_refused_in_one_line(recording, capsys):
    from ertis_detector.model import shipped_model

    model = str(shipped_model(INCUMBENT_CHIRP.name))
    assert main(["detect", str(recording), "--model", model]) == 1
    line = error_of(capsys)
    assert DEFAULT_CHIRP.name in line
    assert INCUMBENT_CHIRP.name in line


def test_a_foreign_file_is_refused_in_one_line(tmp_path, capsys):
    path = tmp_path / "notes.txt"
    path.write_text("no ping at all")
    assert main(["detect", str(path)]) == 1
    assert "notes.txt" in error_of(capsys)


def test_a_recording_cut_short_is_refused_in_one_line_after_what_is_whole(
    recording, tmp_path, capsys
):
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[:900_000])
    assert main(["detect", str(path), "--json"]) == 1
    captured = capsys.readouterr()
    assert len(captured.out.splitlines()) == 1
    assert len(captured.err.splitlines()) == 1
    assert "cut.mcap" in captured.err


@pytest.mark.parametrize("kind", ["--random", "--drives"])
def test_a_picture_is_of_a_scene_and_a_recording_has_a_name(kind, tmp_path, capsys):
    out, picture = tmp_path / "r.mcap", tmp_path / "p.png"
    assert main(["simulate", kind, "-o", str(out), "--plot", str(picture)]) == 1
    assert error_of(capsys).startswith("ertis: --plot draws a scene of yours: ")
    assert main(["simulate", kind]) == 1
    assert error_of(capsys).startswith("ertis: nothing to make: ")
    assert list(tmp_path.iterdir()) == []
