"""``ertis evaluate`` as its user runs it: on a labelled data set, on a recording, on neither."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_daemon.report import detector_page
from ertis_daemon.report.detector_data import judge
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.dataset import DatasetRow, open_dataset, write_table
from ertis_driver.frame import DEFAULT_NUM_WORDS, PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.clutter import Clutter
from ertis_simulator.landmark import Dish
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

NUM_WORDS = 65_536  # 2.5 m of range: short, to be quick
LABELS = ("r35", "r70", "none")
DISH = DishObject("r48", Dish.landmark(48), (1.8, 0.0, 0.6), (np.pi, 0.0))
OPEN = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)

TRUE = {
    "label": "r35",
    "range_m": 1.0,
    "azimuth_rad": 0.0,
    "elevation_rad": 0.0,
    "radius_m": 0.035,
    "visible": True,
}


def noise_ping(path, label, rng, *, source="live", chirp=DEFAULT_CHIRP, truth=None):
    """Loud noise where one label points, faint where another does: something to learn."""
    path.parent.mkdir(parents=True, exist_ok=True)
    words = rng.integers(0, 2**32, NUM_WORDS, dtype=np.uint32)
    if label != "none":
        # Bits of one tone in all microphones, another for each label.
        tone_hz = {"r35": 40e3, "r70": 70e3}[label]
        t = np.arange(NUM_WORDS) / 4.5e6
        words[np.sin(2 * np.pi * tone_hz * t) > 0.3] = 0xFFFFFFFF
    with RecordingWriter(path, RecordingInfo(source, chirp, NUM_WORDS, 20.0)) as writer:
        writer.write(PdmFrame(words, 0, 0), truth)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "set"
    rng = np.random.default_rng(1)
    rows = []
    for room in ("office", "garage"):
        for number in range(12):
            label = LABELS[number % 3]
            name = f"{room}/s{1 + number // 6}/{number + 1:04d}_{label}.mcap"
            noise_ping(folder / name, label, rng)
            rows.append(DatasetRow(name, label, 1.2, 0.1, 0.0, room, f"s{1 + number // 6}", "me"))
    write_table(folder, rows)
    return folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Two simulated pings of one frontal landmark in the open, and one of nothing."""
    path = tmp_path_factory.mktemp("scene") / "open.mcap"
    info = RecordingInfo("sim", DEFAULT_CHIRP, DEFAULT_NUM_WORDS, 20.0)
    with RecordingWriter(path, info) as writer:
        for number, dishes in enumerate([(DISH,), (DISH,), ()]):
            scene = Scene(OPEN, Pose((0.0, 0.0, 0.6), 0.0), dishes, Clutter.none(), seed=1)
            words, truth = scene.hear_and_judge(
                number, DEFAULT_NUM_WORDS, DEFAULT_CHIRP.samples(450e3)
            )
            writer.write(PdmFrame(words, number, number * 10**8), truth)
    return path


def paper(*args):
    return ["evaluate", "--protocol", "paper", "--methods", "paper", "--workers", "1", *args]


def error_of(capsys):
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


class Elements(HTMLParser):
    """What a page is made of, and that every tag that opens closes."""

    VOID = ("meta", "br", "path", "use", "rect", "image", "hr", "link")

    def __init__(self, text):
        super().__init__()
        self.seen, self.open = [], []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.seen.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag


def self_contained(path):
    text = path.read_text(encoding="utf-8")
    page = Elements(text)
    for tag, attributes in page.seen:
        assert tag not in ("script", "link", "img", "iframe"), tag
        for name, value in attributes.items():
            if name in ("href", "src", "xlink:href"):
                assert value.startswith("#"), value
    assert "url(http" not in text
    return text


def test_the_protocol_tells_each_method_on_each_split_with_its_interval(dataset, capsys):
    assert main(paper(str(dataset), "--json", "--repeats", "2", "--folds", "3")) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["pings"] == 24
    assert told["sources"] == ["live"]
    assert told["manifest"] == open_dataset(dataset).manifest_hash
    assert told["choices"]["taper"] == "hann"
    ways = told["methods"]["paper's SVM"]
    assert set(ways) == {"random folds", "environment left out", "session left out"}
    for way in ways.values():
        assert way["overall"]["mean"] == 1.0  # each label hums its own tone
        assert way["detection"]["interval"] == [1.0, 1.0]
        assert np.trace(way["overall_confusion"]) == pytest.approx(24)
    assert ways["environment left out"]["by_group"] == {
        "office": [1.0, 1.0, 1.0],
        "garage": [1.0, 1.0, 1.0],
    }
    assert told["always_the_commonest"]["detection"] == pytest.approx(2 / 3)


def test_the_table_stands_beside_the_papers_own_figures(dataset, capsys):
    assert main(paper(str(dataset), "--repeats", "1", "--folds", "2")) == 0
    text = capsys.readouterr().out
    assert "24 pings" in text
    assert "simulated" not in text
    assert "89.1 ± 0.8" in text
    assert re.search(r"paper's SVM +environment left out +100\.0 ± 0\.0 \[100\.0, 100\.0\]", text)


def test_processes_change_nothing_but_the_time(dataset, capsys):
    told = []
    for workers in ("1", "2"):
        args = paper(str(dataset), "--json", "--repeats", "1", "--folds", "2")
        assert main([*args, "--workers", workers]) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert told[0] == told[1]


def test_the_papers_pipeline_stands_there_by_its_kindest_reading_too(dataset, capsys):
    args = ["evaluate", str(dataset), "--protocol", "paper", "--workers", "1", "--json"]
    args += ["--methods", "paper,paper-kind", "--repeats", "1", "--folds", "2"]
    assert main([*args, "--choice", "microphone=3"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told["methods"]) == ["paper's SVM", "paper's SVM, kindest reading"]
    first, kind = told["methods"].values()
    (gains,) = told["gains_over_the_first"].values()
    for way, gained in gains.items():
        overall = gained["overall"]
        assert overall["mean"] == pytest.approx(
            kind[way]["overall"]["mean"] - first[way]["overall"]["mean"], abs=1e-4
        )
        assert overall["spread"] is None
        assert overall["interval"][0] <= overall["mean"] <= overall["interval"][1]


def test_a_choice_is_made_otherwise_and_the_sweep_tells_what_each_matters(dataset, capsys):
    args = paper(str(dataset), "--json", "--repeats", "1", "--folds", "2", "--sweep")
    assert main([*args, "--choice", "taper=tukey", "--choice", "microphone=5"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["choices"]["taper"], told["choices"]["microphone"]) == ("tukey", "5")
    changes = [one["change"] for one in told["sweep"]]
    assert "taper=hamming" in changes
    assert "taper=tukey" not in changes
    assert {"microphone=beam", "sound=compressed", "scaling=none", "stages=one"} <= set(changes)
    for one in told["sweep"]:
        lost = one["gains"]["overall"]["mean"]
        left_out = one["environment left out"]["overall"]["mean"]
        assert left_out == pytest.approx(1.0 + lost)


def test_the_protocols_page_holds_tables_and_both_confusion_matrices(dataset, tmp_path, capsys):
    page = tmp_path / "paper.html"
    args = paper(str(dataset), "--repeats", "1", "--folds", "2", "--html", str(page))
    assert main(args) == 0
    text = self_contained(page)
    assert "recorded live" in text
    assert "simulated" not in text
    assert f"--html {page}" in text
    assert open_dataset(dataset).manifest_hash in text
    assert text.count("<svg") == 2
    assert "present? environment left out" in text
    assert "which? random folds" in text
    assert "A robot meets rooms that nobody recorded" in text
    again = tmp_path / "again.html"
    assert main([*args[:-1], str(again)]) == 0
    assert again.read_text().replace("again.html", "paper.html") == text


def test_a_ping_without_range_is_left_out_and_said(dataset, tmp_path, capsys):
    rows = list(open_dataset(dataset).rows)
    copied = tmp_path / "copy"
    copied.mkdir()
    for row in rows:
        target = copied / row.file_name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((dataset / row.file_name).read_bytes())
    blind = DatasetRow(rows[0].file_name, rows[0].label, environment="office", session="s1")
    write_table(copied, [blind, *rows[1:]])
    assert main(paper(str(copied), "--repeats", "1", "--folds", "2")) == 0
    assert "23 pings" in (text := capsys.readouterr().out)
    assert "1 more have no range and are left out" in text


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["--choice", "window=hann"], "choice 'window=hann', expected NAME=VALUE of microphone"),
        (["--methods", "papr"], "no method 'papr', expected some of paper"),
        (["--methods", "paper,paper"], "each can be named once"),
        (["--folds", "1"], "--folds 1, expected 2 at least"),
        (["--workers", "0"], "--workers 0, expected 1 at least"),
        (["--html", "/no/such/folder/page.html"], "cannot write /no/such/folder/page.html"),
    ],
)
def test_what_cannot_be_done_is_said_before_the_work(dataset, capsys, args, said):
    assert main(paper(str(dataset), *args)) == 1
    assert said in error_of(capsys)


@pytest.mark.parametrize("name", ["mine.mcap", "notes.txt", "page", "link.html"])
def test_a_page_overwrites_nothing_but_a_page(recording, tmp_path, capsys, name):
    data = tmp_path / "mine.mcap"
    data.write_bytes(recording.read_bytes())
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "link.html").symlink_to(data)
    assert main(["evaluate", str(data), "--html", str(tmp_path / name)]) == 1
    assert f"--html {tmp_path / name}" in error_of(capsys)
    assert data.read_bytes() == recording.read_bytes()
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_no_data_set_and_one_of_one_label_are_told_apart(tmp_path, capsys):
    assert main(paper(str(tmp_path))) == 1
    assert "is no labelled data set" in error_of(capsys)
    rng = np.random.default_rng(1)
    noise_ping(tmp_path / "a.mcap", "none", rng)
    write_table(tmp_path, [DatasetRow("a.mcap", "none", 1.0, environment="a", session="s")])
    assert main(paper(str(tmp_path))) == 1
    assert "labels none: the protocol needs two landmarks at least" in error_of(capsys)
    assert main(paper(str(tmp_path), str(tmp_path))) == 1
    assert "--protocol takes one data set, met 2" in error_of(capsys)


def test_the_detector_is_judged_on_a_recording_with_truth(recording, tmp_path, capsys):
    page = tmp_path / "page.html"
    args = ["evaluate", str(recording), "--workers", "1", "--json", "--html", str(page)]
    assert main([*args, "--rate", "5"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["pings"], told["sources"]) == (3, ["sim"])
    heard = told["conditions"]["can be heard"]
    assert heard["located"]["trials"] == 2
    assert heard["right_size"]["successes"] == heard["located"]["successes"] == 2
    assert (told["false_alarms"]["free_pings"], told["false_alarms"]["rate_hz"]) == (1, 5.0)
    assert told["false_alarms"]["per_minute"] == 0.0
    assert abs(told["place"]["bias"]["range_m"]) < 0.03
    assert 0 < told["seconds_per_ping"]["median"] < told["seconds_per_ping"]["most"] * 1.0001
    text = self_contained(page)
    assert "none of this was heard by a real sonar" in text
    assert told["model"] in text
    assert told["data"][0]["digest"] in text
    assert text.count("<svg") == 5


def test_the_detector_is_judged_on_a_live_data_set_by_its_labels(dataset, capsys):
    assert main(["evaluate", str(dataset), "--workers", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["pings"], told["groups"], told["sources"]) == (24, 4, ["live"])
    assert told["conditions"]["can be heard"]["located"]["trials"] == 16
    assert told["false_alarms"]["free_pings"] == 8
    assert {one["low"] for one in told["over"]["range (m)"]} == {1.0}
    assert told["over"]["signal-to-clutter (dB)"] == []  # nobody knows


@pytest.mark.parametrize(
    ("label", "truth", "asked"),
    [
        ("r35", {"label": {"label": "r35", "range_m": 1.0}}, 1),  # as a person recorded it
        ("none", {"label": {"label": "none"}}, 0),
        ("none", {"landmarks": [TRUE]}, 0),  # somebody corrected the table
        ("r35", {"landmarks": []}, 1),
        ("r35", {"landmarks": [TRUE, {**TRUE, "label": "r70"}]}, 2),  # it knows more than the table
    ],
)
def test_the_table_is_believed_unless_the_recording_knows_more(
    tmp_path, capsys, label, truth, asked
):
    noise_ping(tmp_path / "a.mcap", label, np.random.default_rng(1), truth=truth)
    row = DatasetRow("a.mcap", label, 1.0, 0.0, environment="a", session="s")
    write_table(tmp_path, [row])
    assert main(["evaluate", str(tmp_path), "--workers", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["conditions"]["can be heard"]["located"]["trials"] == asked


def test_data_named_twice_is_refused_not_counted_twice(recording, dataset, tmp_path, capsys):
    in_it = next(dataset.rglob("*.mcap"))
    for command in (["evaluate"], ["train", "-o", str(tmp_path / "m")]):
        for data, file in ((recording, recording), (dataset, in_it)):
            again = data.parent / "x" / ".." / data.name
            (data.parent / "x").mkdir(exist_ok=True)
            for twice in ((data, data), (data, again), (data, file)):
                assert main([*command, *map(str, twice)]) == 1
                assert "is given twice, first as" in error_of(capsys)
        assert main([*command, str(dataset), str(in_it)]) == 1
        assert f"{in_it} is given twice, first as {in_it}: name it once" in error_of(capsys)


@pytest.mark.parametrize("dishes", [(), (DISH,)])
def test_what_one_ping_does_not_tell_is_not_known(tmp_path, capsys, dishes):
    path = tmp_path / "one.mcap"
    scene = Scene(OPEN, Pose((0.0, 0.0, 0.6), 0.0), dishes, Clutter.none(), seed=1)
    words, truth = scene.hear_and_judge(0, DEFAULT_NUM_WORDS, DEFAULT_CHIRP.samples(450e3))
    info = RecordingInfo("sim", DEFAULT_CHIRP, DEFAULT_NUM_WORDS, 20.0)
    with RecordingWriter(path, info) as writer:
        writer.write(PdmFrame(words, 0, 0), truth)
    assert main(["evaluate", str(path), "--workers", "1"]) == 0
    text = capsys.readouterr().out
    assert "not known (1 sigma) with each size's mean taken out" in text
    assert not re.search(r"\bnan\b", text)


def test_a_model_that_was_trained_on_what_it_is_judged_by_is_named_so(recording, capsys):
    report = judge([recording])
    assert report.met_before == ()
    assert "TRAINED ON" not in detector_page.text(report)
    digest = report.data[0][1].split()[-1]
    boast = replace(report, model_data=f"2 pings: {recording} sha256 {digest[:16]}")
    assert boast.met_before == (str(recording),)
    assert f"THE MODEL WAS TRAINED ON {recording}" in detector_page.text(boast)
    assert detector_page.as_json(boast)["trained_on"] == [str(recording)]


def test_a_recording_without_truth_or_chirp_says_so(tmp_path, capsys):
    rng = np.random.default_rng(1)
    noise_ping(tmp_path / "live.mcap", "none", rng)
    assert main(["evaluate", str(tmp_path / "live.mcap"), "--workers", "1"]) == 1
    assert "ping 0 has no truth: nothing to judge by" in error_of(capsys)
    noise_ping(tmp_path / "mute.mcap", "none", rng, chirp=None, truth={"landmarks": []})
    assert main(["evaluate", str(tmp_path / "mute.mcap"), "--workers", "1"]) == 1
    assert "says no chirp" in error_of(capsys)
    noise_ping(tmp_path / "bad.mcap", "none", rng, truth={"landmarks": [{"label": "r35"}]})
    assert main(["evaluate", str(tmp_path / "bad.mcap"), "--workers", "1"]) == 1
    assert "its truth lacks or garbles a landmark's field: 'range_m'" in error_of(capsys)
    for flags, said in (
        (["--rate", "0"], "--rate 0, expected above 0"),
        (["--rate", "nan"], "--rate nan, expected above 0, up to 1000"),
        (["--rate", "inf"], "--rate inf, expected above 0, up to 1000"),
        (["--min-probability", "2"], "--min-probability 2, expected above 0, up to 1"),
    ):
        assert main(["evaluate", str(tmp_path / "live.mcap"), *flags]) == 1
        assert said in error_of(capsys)
