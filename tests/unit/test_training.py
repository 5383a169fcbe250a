"""Recordings with truth, or labelled data sets, to a model that recognises what it was taught."""

import contextlib
import dataclasses
import hashlib
import io
import itertools
import json
import math
import shutil

import numpy as np
import pytest

from ertis_daemon import calibrating, drives, training
from ertis_daemon.cli import main
from ertis_daemon.pipeline import build_detector
from ertis_detector.air import Air
from ertis_detector.detection import NONE
from ertis_detector.false_tracks import FalseTracks
from ertis_detector.model import load_model, save_model, shipped_model
from ertis_detector.recalibration import Recalibration
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.dataset import open_dataset
from ertis_driver.device import Settings
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter, open_recording
from ertis_simulator.clutter import Clutter
from ertis_simulator.landmark import Dish
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

NUM_WORDS = 163_840
CHIRP = DEFAULT_CHIRP.samples(450e3)
OPEN = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)
LABELS = ("r40", NONE, "r66", NONE)  # a user's own sizes
NUM_PINGS = 64


def place(number):
    """Range and azimuth of ping ``number``'s landmark."""
    rng = np.random.default_rng([7, number])
    return float(rng.uniform(1.0, 3.0)), float(rng.uniform(-0.15, 0.15))


def scene(number, label):
    range_m, azimuth = place(number)
    at = (range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0.6)
    dishes = ()
    if label != NONE:
        facing = (azimuth + np.pi + 0.01 * (number % 20), 0.0)
        dishes = (DishObject(label, Dish.landmark(int(label[1:])), at, facing),)
    rng = np.random.default_rng([8, number])
    clutter = Clutter.scatter((3.2, 5.0), (-1.5, 1.5), 1.0, rng)
    start = Pose((0.0, 0.0, 0.6), 0.0)
    return Scene(OPEN, start, dishes, clutter, seed=number, name=f"scene {number}")


def record(path, pings):
    """Words and truth of each ping, as a simulator would."""
    with RecordingWriter(path, RecordingInfo("sim", DEFAULT_CHIRP, NUM_WORDS)) as writer:
        for number, (words, truth) in enumerate(pings):
            writer.write(PdmFrame(words, number, 0), truth)
    return path


@pytest.fixture(scope="module")
def heard():
    """Label, words and truth of each ping."""
    pings = []
    for number in range(NUM_PINGS):
        label = LABELS[number % len(LABELS)]
        there = scene(number, label)
        pings.append((label, there.hear(0, NUM_WORDS, CHIRP), there.truth(0)))
    return pings


@pytest.fixture(scope="module")
def recording(heard, tmp_path_factory):
    path = tmp_path_factory.mktemp("training") / "taught.mcap"
    return record(path, [(words, truth) for _, words, truth in heard])


@pytest.fixture(scope="module")
def here(heard, tmp_path_factory):
    """The same rooms, four times: what somebody recorded and labelled to calibrate with."""
    path = tmp_path_factory.mktemp("here") / "here.mcap"
    with RecordingWriter(path, RecordingInfo("live", DEFAULT_CHIRP, NUM_WORDS)) as writer:
        for number in range(4 * 52):
            _, words, truth = heard[number % 52]
            writer.write(PdmFrame(words, number, 0), {**truth, "scene": f"here {number % 52}"})
    return path


@pytest.fixture(scope="module")
def dataset(heard, tmp_path_factory):
    """As a person with a sonar makes it: single pings without truth, and a table of labels."""
    folder = tmp_path_factory.mktemp("data")
    lines = [
        "file_name,label,range_m,azimuth_deg,yaw_deg,environment,session,operator,sha256,quality"
    ]
    for number, (label, words, _) in enumerate(heard):
        name = f"yard/s{number // 8}/{number:04d}_{label}.mcap"
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with RecordingWriter(path, RecordingInfo("live", DEFAULT_CHIRP, NUM_WORDS)) as writer:
            writer.write(PdmFrame(words, number, 0))
        range_m, azimuth = place(number)
        yaw = f"{np.rad2deg(0.01 * (number % 20)):.1f}" if label != NONE else ""
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        where = f"{range_m:.3f},{np.rad2deg(azimuth):.1f}"
        lines.append(f"{name},{label},{where},{yaw},yard,s{number // 8},me,{digest},good")
    (folder / "metadata.csv").write_text("\n".join(lines) + "\n")
    return folder


@pytest.fixture(scope="module")
def taught(recording, tmp_path_factory):
    """A model of the recording, made by one worker, and what was said of it."""
    path = tmp_path_factory.mktemp("taught") / "m.safetensors"
    return train(recording, path, "--workers", "1"), path


def train(source, path, *options):
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["train", str(source), "-o", str(path), *options]) == 0
    return json.loads(said.getvalue())


def recognised(model_path):
    """Right answers among 12 new pings, and false ones."""
    detector = build_detector(Settings(), Air(), str(model_path), min_probability=0.5)
    right = false = 0
    for number in range(100, 112):
        label = LABELS[number % len(LABELS)]
        words = scene(number, label).hear(0, NUM_WORDS, CHIRP)
        found = [one.label for one in detector.detect(PdmDecoder().decode(words).audio)]
        right += found == ([label] if label != NONE else [])
        false += len(set(found) - {label})
    return right, false


def test_a_model_knows_the_sizes_it_was_taught(taught):
    said, path = taught
    model = load_model(path)
    assert model.classes == ("none", "r40", "r66")
    assert model.card.source == said["source"] == "sim"
    assert model.card.in_sight == 0.5
    assert said["landmark_proposals"] > 24
    assert model.card.tracking["found"] >= model.card.figures["found"]
    assert model.card.data.startswith("64 pings: recording sha256 ")
    right, false = recognised(path)
    assert right >= 9
    assert false <= 1


def test_a_labelled_data_set_without_truth_teaches_as_well(dataset, tmp_path):
    path = tmp_path / "m.safetensors"
    assert train(dataset, path)["source"] == "live"
    assert open_dataset(dataset).manifest_hash[:16] in load_model(path).card.data
    assert recognised(path)[0] >= 9


def test_neither_workers_nor_another_go_change_the_model(recording, taught, tmp_path):
    again = tmp_path / "again.safetensors"
    train(recording, again, "--workers", "2")
    assert again.read_bytes() == taught[1].read_bytes()


def test_other_recordings_say_how_sure_to_be(heard, recording, taught, tmp_path):
    """What is learnt is of the first ones, whatever the others hold."""
    other = tmp_path / "other.mcap"
    with RecordingWriter(other, RecordingInfo("sim", DEFAULT_CHIRP, NUM_WORDS)) as writer:
        for number, (_, words, truth) in enumerate(heard[8:]):
            writer.write(PdmFrame(words, number, 0), {**truth, "scene": f"other {number}"})
    path = tmp_path / "m.safetensors"
    said = train(recording, path, "--calibrate", str(other))
    model, alone = load_model(path), load_model(taught[1])
    rows = np.random.default_rng(1).normal(0, 1, (50, len(model.readout.mean))).astype(np.float32)
    np.testing.assert_array_equal(model.classifier.votes(rows), alone.classifier.votes(rows))
    assert not np.array_equal(model.classifier.coupling, alone.classifier.coupling)
    of_all, of_others = model.card.data.split("; calibrated on ")
    assert of_all == alone.card.data
    assert of_others.startswith("56 pings: recording sha256 ")
    assert said["landmark_proposals"] < taught[0]["landmark_proposals"]


def test_a_model_calibrated_here_votes_the_same_and_is_as_sure_as_it_may_be(
    here, taught, tmp_path, capsys
):
    path, driven = tmp_path / "here.safetensors", tmp_path / "driven.safetensors"
    before = load_model(taught[1])
    # It has heard drives, which mean nothing once probabilities are told by another law.
    tracking = {**before.card.tracking, **FalseTracks(0.01, 0.6).figures()}
    data = f"{before.card.data}; drives without landmarks, 9 pings: x"
    card = dataclasses.replace(before.card, tracking=tracking, data=data)
    save_model(dataclasses.replace(before, card=card), driven)
    assert main(["calibrate", str(here), "-o", str(path), "--model", str(driven)]) == 0
    said = json.loads(capsys.readouterr().out)
    after = load_model(path)
    assert FalseTracks.from_figures(after.card.tracking) is None
    np.testing.assert_array_equal(after.classifier.trees.leaves, before.classifier.trees.leaves)
    slope = after.classifier.coupling / before.classifier.coupling
    np.testing.assert_allclose(slope, said["slope"], atol=1e-3)
    assert said["slope"] > 1.05, "it learnt these very pings: nothing is surer"
    assert after.card.min_probability == said["min_probability"]
    errors = said["expected_calibration_error"], said["expected_calibration_error_elsewhere"]
    assert errors[1] < errors[0]
    assert after.card.name == f"{before.card.name}-calibrated"
    assert (before.card.source, after.card.source) == ("sim", "live+sim")
    assert after.card.data.startswith(f"{before.card.data}; recalibrated on 208 pings: recording ")
    assert after.card.tracking["false_alarms_per_ping"] >= round(3 / 208, 5)


def test_a_threshold_stays_where_something_can_be_reported(here, taught, tmp_path, monkeypatch):
    monkeypatch.setattr(calibrating, "fit_recalibration", lambda *args: Recalibration(1.0, 20.0))
    made = calibrating.calibrate([here], taught[1], 1).model
    assert made.card.min_probability == 0.999


def test_what_is_too_little_or_strange_to_calibrate_with_is_said(
    here, recording, taught, tmp_path, capsys
):
    where = ("-o", str(tmp_path / "m"), "--model", str(taught[1]))
    line = refusal(capsys, str(recording), *where, command="calibrate")
    assert line.startswith("ertis: 64 pings with ")
    assert "expected 200 pings and 20 of each or more: record more" in line
    line = refusal(capsys, str(here), *where[:2], command="calibrate")
    assert "labels r40, r66: the model knows none, r35, r48, r58, r70, unknown" in line
    other = ("--model", str(shipped_model(INCUMBENT_CHIRP.name)))
    line = refusal(capsys, str(here), *where[:2], *other, command="calibrate")
    assert f"was trained for chirp {INCUMBENT_CHIRP.name}" in line


def refusal(capsys, *args, command="train"):
    assert main([command, *args]) == 1
    [line] = capsys.readouterr().err.splitlines()
    return line


def blind(path, chirp=DEFAULT_CHIRP, **info):
    with RecordingWriter(path, RecordingInfo("live", chirp, NUM_WORDS, **info)) as writer:
        words = np.zeros(NUM_WORDS, np.uint32)
        writer.write(PdmFrame(words, 0, 0, pdm_rate_hz=writer.info.pdm_rate_hz))
    return str(path)


def test_training_needs_truth(tmp_path, capsys):
    line = refusal(capsys, blind(tmp_path / "blind.mcap"), "-o", str(tmp_path / "m"))
    assert "blind.mcap" in line
    assert "no truth" in line


def test_a_model_that_cannot_be_written_is_said_before_the_work(tmp_path, capsys):
    recording = blind(tmp_path / "blind.mcap")  # which would be refused, if it were read
    line = refusal(capsys, recording, "-o", str(tmp_path / "none" / "m"))
    assert "none/m: name a file in a folder that exists" in line
    line = refusal(capsys, recording, "-o", str(tmp_path / "m"), "--workers", "0")
    assert "--workers 0, expected 1 at least" in line


def test_nothing_is_calibrated_on_what_was_learnt(recording, tmp_path, capsys):
    same, model = str(recording), str(tmp_path / "m")
    line = refusal(capsys, same, "--calibrate", same, "-o", model)
    assert f"{same} is given twice" in line
    copy = shutil.copy(recording, tmp_path / "copy.mcap")
    line = refusal(capsys, same, "--calibrate", str(copy), "-o", model)
    assert "scenes or sessions are there to learn from and to be calibrated on" in line
    assert "expected others" in line


@pytest.mark.parametrize("as_what", [(), ("--calibrate",)])
def test_two_chirps_make_no_model(recording, tmp_path, capsys, as_what):
    other = blind(tmp_path / "other.mcap", INCUMBENT_CHIRP)
    line = refusal(capsys, str(recording), *as_what, other, "-o", str(tmp_path / "m"))
    assert DEFAULT_CHIRP.name in line
    assert INCUMBENT_CHIRP.name in line


def test_a_label_without_a_range_is_named(dataset, tmp_path, capsys):
    folder = tmp_path / "copy"
    shutil.copytree(dataset, folder)
    table = folder / "metadata.csv"
    lines = table.read_text().splitlines()
    first = lines[1].split(",")
    lines[1] = ",".join([*first[:2], "", *first[3:]])
    table.write_text("\n".join(lines) + "\n")
    line = refusal(capsys, str(folder), "-o", str(tmp_path / "m"))
    assert first[0] in line
    assert "range_m" in line


def test_a_labelled_recording_by_itself_is_sent_back_to_its_data_set(tmp_path, capsys):
    silence = np.zeros(NUM_WORDS, np.uint32)
    path = record(tmp_path / "labelled.mcap", [(silence, {"label": {"label": "r48"}})])
    line = refusal(capsys, str(path), "-o", str(tmp_path / "m"))
    assert "no truth" in line
    assert "data set, so name that folder" in line


@pytest.mark.parametrize("only", ["r40", NONE])
def test_echoes_of_one_kind_make_no_model(heard, tmp_path, capsys, monkeypatch, only):
    path = record(tmp_path / "one.mcap", [(words, truth) for _, words, truth in heard[:4]])
    read = training.read_rows

    def of_one_kind(*args):
        rows = read(*args)
        return dataclasses.replace(rows, labels=[only] * len(rows.labels))

    monkeypatch.setattr(training, "read_rows", of_one_kind)
    line = refusal(capsys, str(path), "-o", str(tmp_path / "m"))
    assert f"echoes of {only} in 4 pings, expected some of landmarks" in line


def test_a_size_of_which_no_turn_is_known_is_named(heard, tmp_path, capsys, monkeypatch):
    def half_known(truth):
        places = [dict(item) for item in truth["landmarks"]]
        for item in places:
            if item["label"] == "r66":
                del item["tilt_rad"]
        return truth | {"landmarks": places}

    monkeypatch.setattr(training, "_LEAST_LANDMARKS", 5)
    pings = [(words, half_known(truth)) for _, words, truth in heard]
    path = record(tmp_path / "turned.mcap", pings)
    line = refusal(capsys, str(path), "-o", str(tmp_path / "m"))
    assert "of r66 none of known turn is recognised" in line


def test_too_few_landmarks_are_told_by_number(heard, tmp_path, capsys):
    path = record(tmp_path / "few.mcap", [(words, truth) for _, words, truth in heard[:24]])
    assert "expected 20 or more" in refusal(capsys, str(path), "-o", str(tmp_path / "m"))


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """Simulated drives without a landmark."""
    path = tmp_path_factory.mktemp("driven") / "drives.mcap"
    assert main(["simulate", "--drives", "-n", "60", "-j", "2", "-o", str(path)]) == 0
    return path


def test_drives_go_on_through_rooms_without_a_landmark(driven):
    pings = list(open_recording(driven))
    assert all(not ping.truth["landmarks"] and not ping.truth["decoys"] for ping in pings)
    scenes = [ping.truth["scene"] for ping in pings]
    assert scenes[0] == "drive 1/0"
    assert 2 <= len(set(scenes)) <= 4
    for before, after in itertools.pairwise(pings):
        step_s = (after.frame.ping_time_ns - before.frame.ping_time_ns) / 1e9
        poses = [ping.truth["pose"] for ping in (before, after)]
        gone_m = math.hypot(*(poses[1][name] - poses[0][name] for name in ("x_m", "y_m")))
        if before.truth["scene"] == after.truth["scene"]:
            assert step_s == pytest.approx(1 / 7)
            assert gone_m == pytest.approx(0.5 / 7, rel=0.01)
        else:
            assert step_s > 60.0


def test_drives_tell_a_model_how_seldom_its_tracks_are_false(driven, tmp_path, capsys, monkeypatch):
    fifty = np.linspace(-3.0, 2.0, 50).tolist()  # so short a drive meets a thing or two
    monkeypatch.setattr(drives, "peaks", lambda drive, tracker: fifty if list(drive) else [])
    path = tmp_path / "m.safetensors"
    assert main(["calibrate", "--drives", str(driven), "-o", str(path), "--workers", "1"]) == 0
    said = json.loads(capsys.readouterr().out)
    before, after = load_model(shipped_model(DEFAULT_CHIRP.name)), load_model(path)
    np.testing.assert_array_equal(after.classifier.coupling, before.classifier.coupling)
    law = FalseTracks.from_figures(after.card.tracking)
    assert law is not None
    assert said["false_tracks_fade"] == law.fade
    assert after.card.figures == before.card.figures
    of_others, of_drives = after.card.data.split("; drives without landmarks, ")
    assert before.card.data.startswith(of_others)
    assert of_drives.startswith("60 pings: recording sha256 ")


def test_drives_end_where_another_scene_begins_or_nothing_is_heard_or_time_goes_back():
    def ping(number, time_s, scene="a"):
        return drives._Ping(number, round(time_s * 1e9), [], scene, None)

    told = [
        ping(0, 0.0),
        ping(1, 1.0),
        ping(2, 9.0),
        ping(3, 9.5),
        ping(4, 9.6, "b"),
        ping(5, 1.0, "b"),
    ]
    parts = [[one.number for one in drive] for drive in drives._drives(told)]
    assert parts == [[0, 1], [2, 3], [4], [5]]


@pytest.mark.parametrize(
    "pose", [None, {}, {"x_m": 1.0}, {"x_m": 1, "y_m": math.nan, "yaw_rad": 0}]
)
def test_a_pose_that_is_none_counts_as_unknown(pose):
    assert drives._pose(pose) is None


def test_drives_that_say_nothing_are_refused(recording, driven, taught, tmp_path, capsys):
    out = ("-o", str(tmp_path / "m"), "--workers", "1")
    line = refusal(capsys, *out, command="calibrate")
    assert line == "ertis: nothing to calibrate with: name labelled recordings, or --drives"
    line = refusal(capsys, "--drives", str(recording), *out, command="calibrate")
    assert "taught.mcap: ping 0 has a landmark in it, expected drives without any" in line
    line = refusal(capsys, "--drives", str(driven), *out, command="calibrate")
    assert "expected 40: drive for longer" in line
    twice = (str(recording), "--drives", str(driven), str(driven))
    line = refusal(capsys, *twice, *out, command="calibrate")
    assert f"{driven} is given twice, first as {driven}: name it once" in line
    other = blind(tmp_path / "other.mcap", INCUMBENT_CHIRP)
    with_ours = ("--model", str(shipped_model(DEFAULT_CHIRP.name)))
    line = refusal(capsys, "--drives", other, *with_ours, *out, command="calibrate")
    assert f"was trained for chirp {DEFAULT_CHIRP.name}" in line
    slow = blind(tmp_path / "slow.mcap", pdm_rate_hz=1_125_000)
    line = refusal(capsys, "--drives", slow, *out, command="calibrate")
    assert "detection needs 4500000" in line
    assert not (tmp_path / "m").exists()


def test_what_was_recorded_at_another_clock_teaches_nothing(heard, tmp_path, capsys):
    path = tmp_path / "slow.mcap"
    info = RecordingInfo("sim", DEFAULT_CHIRP, NUM_WORDS, pdm_rate_hz=1_125_000)
    with RecordingWriter(path, info) as writer:
        writer.write(PdmFrame(heard[0][1], 0, 0, pdm_rate_hz=info.pdm_rate_hz), heard[0][2])
    line = refusal(capsys, str(path), "-o", str(tmp_path / "m"), "--workers", "1")
    assert "detection needs 4500000" in line
