"""The labelled data set: its plan, its variants, and the files on disk."""

import collections
import csv
import hashlib
import json
import resource
import subprocess
import sys

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.dataset import COLUMNS
from ertis_driver.recording import read_recording
from ertis_simulator.environments import ENVIRONMENTS
from ertis_simulator.paper_dataset import (
    LABELS,
    NONE_KINDS,
    VARIANTS,
    build_scene,
    plan,
)

PLAN = plan()


def built(variant, count=35, seed=1):
    chosen = VARIANTS[variant]
    return [(ping, build_scene(seed, ping, chosen)) for ping in PLAN[:count]]


def landmarks(labelled, number=0):
    return labelled.scene.truth(number)["landmarks"]


def test_the_papers_pings_are_dealt_evenly():
    assert len(PLAN) == 944
    rooms = collections.Counter(ping.environment for ping in PLAN)
    assert set(rooms) == set(ENVIRONMENTS)
    assert set(rooms.values()) == {134, 135}
    labels = collections.Counter(ping.label for ping in PLAN)
    assert set(labels) == set(LABELS)
    assert max(labels.values()) - min(labels.values()) <= 7
    in_room = collections.Counter((ping.environment, ping.label) for ping in PLAN)
    assert set(in_room.values()) <= {26, 27}
    assert len({ping.file_name for ping in PLAN}) == 944
    assert PLAN[0].file_name == "open_lab/s1/0001_r35.mcap"
    assert plan(50) == PLAN[:50]


@pytest.mark.parametrize("variant", VARIANTS)
def test_the_label_says_what_stands_at_its_range_and_bearing(variant):
    for ping, labelled in built(variant, 40):
        told = landmarks(labelled, ping.number)
        at_label = [
            item["label"]
            for item in told
            if abs(item["range_m"] - labelled.range_m) < 0.01
            and abs(item["azimuth_rad"] - labelled.azimuth_rad) < 0.01
        ]
        assert at_label == ([] if ping.label == "none" else [ping.label])
        low, high = VARIANTS[variant].range_m
        assert low <= labelled.range_m <= high
        x, y, _ = labelled.scene.start.position_m
        room = labelled.scene.room
        assert room.x_m[0] < x < room.x_m[1]
        assert room.y_m[0] < y < room.y_m[1]


def test_landmarks_of_the_paper_set_are_near_the_axis_in_sight_and_turned_by_30_at_most():
    for ping, labelled in built("paper"):
        for item in landmarks(labelled, ping.number):
            assert not item["shadowed"]
            assert abs(np.rad2deg(item["azimuth_rad"])) <= 20.1
            assert np.rad2deg(item["tilt_rad"]) < 37  # 30 across, some elevation on top
            assert abs(labelled.yaw_rad) <= np.deg2rad(30)


def test_something_stands_where_most_none_pings_point():
    found = collections.Counter()
    for ping, labelled in built("paper", 300):
        if ping.label != "none":
            assert not np.isnan(labelled.yaw_rad)
            continue
        assert np.isnan(labelled.yaw_rad)
        truth = labelled.scene.truth(ping.number)
        assert truth["landmarks"] == []
        here = [
            item["label"]
            for item in truth["objects"][-1:] + truth["decoys"]
            # A box reaches behind its front, a stand below its top.
            if abs(item["azimuth_rad"] - labelled.azimuth_rad) < 0.02
            and -0.01 < item["range_m"] - labelled.range_m < 0.6
        ]
        found[here[0] if here else "nothing"] += 1
    assert set(found) == set(NONE_KINDS)
    assert found["nothing"] < 0.25 * sum(found.values())


def test_each_variant_is_harder_in_its_own_way():
    for ping, labelled in built("turned"):
        for item in landmarks(labelled, ping.number):
            assert 29 < np.rad2deg(item["tilt_rad"]) < 65
    assert {len(landmarks(one)) for ping, one in built("two") if ping.label != "none"} == {2}
    for _, labelled in built("decoys", 14):
        truth = labelled.scene.truth(0)
        concave = [i for i in truth["objects"] if i["label"].endswith("hedral")]
        assert len(truth["decoys"]) + len(concave) >= 2
    assert max(one.range_m for _, one in built("far")) > 4.5
    bearings = [abs(np.rad2deg(one.azimuth_rad)) for _, one in built("off-axis")]
    assert min(bearings) >= 20
    assert 50 < max(bearings) <= 60
    temperatures = [one.scene.air.temperature_c for _, one in built("temperature")]
    assert all(-5 <= t <= 5 or 30 <= t <= 40 for t in temperatures)
    dead = [one.scene.dead_mics for _, one in built("dead-mics")]
    assert all(2 <= len(mics) <= 8 for mics in dead)
    rooms, others = (
        [one.scene.room for _, one in built(name, 7)] for name in ("paper", "unseen-rooms")
    )
    assert not set(rooms) & set(others)


def test_pings_of_a_session_share_place_and_sonar_and_differ_in_what_is_put_there():
    first, second = (build_scene(1, ping, VARIANTS["paper"]) for ping in (PLAN[0], PLAN[7]))
    assert PLAN[0].session_name == PLAN[7].session_name
    assert first.scene.room == second.scene.room
    assert first.scene.start == second.scene.start
    assert first.scene.seed == second.scene.seed  # microphones and ring-down of one sonar
    assert first.range_m != second.range_m
    other = build_scene(1, PLAN[7 * 27], VARIANTS["paper"])
    assert other.scene.room == first.scene.room
    assert other.scene.start != first.scene.start


def make(folder, *options, count=3):
    return main(["simulate", "--dataset", str(folder), "-n", str(count), "--seed", "5", *options])


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "one"
    assert make(folder, "-j", "2") == 0
    return folder


def error_of(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_the_table_names_each_file_with_its_label_and_hash(dataset):
    with (dataset / "metadata.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert COLUMNS[0] == "file_name"
    assert [row["file_name"] for row in rows] == [ping.file_name for ping in PLAN[:3]]
    for row, ping in zip(rows, PLAN, strict=False):
        data = (dataset / row["file_name"]).read_bytes()
        assert row["sha256"] == hashlib.sha256(data).hexdigest()
        assert (row["label"], row["environment"], row["session"]) == (
            ping.label,
            ping.environment,
            "s1",
        )
        assert row["operator"] == "simulated"
        assert row["quality"] in ("good", "weak", "shadowed")
        recording = read_recording(dataset / row["file_name"])
        (recorded,) = recording
        assert recording.info.source == "sim"
        said = recorded.truth["label"]
        assert said["label"] == row["label"]
        assert said["range_m"] == float(row["range_m"])
        item = recorded.truth["landmarks"][0]
        assert item["range_m"] == pytest.approx(float(row["range_m"]), abs=1e-4)
        assert {"tilt_rad", "radius_m", "shadowed", "visible", "own_to_rest_db"} <= set(item)
        assert row["quality"] == ("good" if item["own_to_rest_db"] >= 0 else "weak")


def test_one_worker_makes_the_same_bytes_as_two(dataset, tmp_path):
    assert make(tmp_path / "again", "-j", "1") == 0
    assert contents(tmp_path / "again") == contents(dataset)


def test_what_is_missing_is_made_again_and_only_that(dataset, tmp_path, capsys):
    folder = tmp_path / "copy"
    whole = contents(dataset)
    for name, data in whole.items():
        if name != "metadata.csv" and "office" not in name:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
    torn = folder / f"{PLAN[1].file_name}.part"
    torn.parent.mkdir(parents=True)
    torn.write_bytes(b"half a recording")
    assert make(folder) == 0
    assert "1 of them made now" in capsys.readouterr().err
    assert contents(folder) == whole


def test_a_folder_of_another_data_set_is_refused(dataset, capsys):
    before = contents(dataset)
    assert main(["simulate", "--dataset", str(dataset), "-n", "3", "--seed", "6"]) == 1
    assert "another data set" in error_of(capsys)
    assert make(dataset, "--variant", "far") == 1
    assert "another data set" in error_of(capsys)
    assert contents(dataset) == before


def test_a_folder_with_something_else_in_it_is_refused(tmp_path, capsys):
    (tmp_path / "holiday.jpg").write_bytes(b"")
    assert make(tmp_path) == 1
    assert "not empty" in error_of(capsys)


def test_an_unknown_variant_lists_the_known_ones(tmp_path, capsys):
    assert make(tmp_path / "x", "--variant", "turnd") == 1
    assert "expected one of paper, turned, two" in error_of(capsys)
    assert make(tmp_path / "x", "--variant", "help") == 0
    assert len(capsys.readouterr().out.splitlines()) == len(VARIANTS)
    assert not (tmp_path / "x").exists()


def test_a_file_that_cannot_be_written_whole_is_not_left_at_all(tmp_path):
    folder = tmp_path / "full"

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))

    done = subprocess.run(
        [sys.executable, "-m", "ertis_daemon.cli", "simulate", "--dataset", folder, "-n", "1"],
        preexec_fn=small_files,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "cannot write" in done.stderr
    assert "File too large" in done.stderr
    assert "kept" not in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert list(contents(folder)) == ["dataset.json"]


def test_a_data_set_says_how_it_was_made(dataset):
    said = json.loads((dataset / "dataset.json").read_text())
    assert said["source"] == "sim"
    assert (said["seed"], said["num_pings"], said["variant"]) == (5, 3, "paper")
