"""``ertis dataset check`` finds each planted mistake; relabel and stats."""

import csv
import json
import math
import shutil

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.dataset import DatasetRow, file_sha256, open_dataset, write_table
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.landmark import Dish
from ertis_simulator.objects import DishObject
from ertis_simulator.path import Pose
from ertis_simulator.room import Room
from ertis_simulator.scene import Scene

NUM_WORDS = 163_840
SAMPLES = DEFAULT_CHIRP.samples(450e3)
START_NS = 1_700_000_000 * 10**9
RANGE_M = {"r48": 2.1, "r70": 3.0, "none": 2.5}


@pytest.fixture(scope="module")
def words():
    """What a sonar hears of a dish in an empty hall, or of none."""
    heard = {}
    for seed, (label, range_m) in enumerate(RANGE_M.items()):
        dishes = ()
        if label != "none":
            vertex, facing = (range_m, 0.0, 0.9), (math.pi, 0.0)
            dishes = (DishObject(label, Dish.landmark(int(label[1:])), vertex, facing, True),)
        scene = Scene(
            room=Room((-4.0, 6.0), (-4.0, 4.0)),
            start=Pose((0.0, 0.0, 0.9), 0.0),
            dishes=dishes,
            seed=1,
        )
        for number in range(4):
            heard[label, number] = scene.hear(10 * seed + number, NUM_WORDS, SAMPLES)
    return heard


def place(folder, words, environment, session, number, label, *, chirp=DEFAULT_CHIRP, time_s=0):
    name = f"{environment}/{session}/{number:04d}_{label}.mcap"
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    said = {"label": label, "environment": environment, "session": session}
    with RecordingWriter(path, RecordingInfo("live", chirp, NUM_WORDS, 20.0)) as writer:
        writer.write(PdmFrame(words, number, START_NS + int(time_s * 1e9)), {"label": said})
    return DatasetRow(
        name,
        label,
        RANGE_M[label],
        0.0,
        math.nan if label == "none" else 0.0,
        environment,
        session,
        "ann",
        file_sha256(path),
        "good",
    )


@pytest.fixture(scope="module")
def sound_set(words, tmp_path_factory):
    folder = tmp_path_factory.mktemp("check") / "set"
    rows = []
    for at, environment in enumerate(("garage", "hall")):
        for number, label in enumerate(RANGE_M, 1):
            heard = words[label, at]
            rows.append(
                place(folder, heard, environment, "s1", number, label, time_s=3600 * at + number)
            )
    write_table(folder, rows)
    return folder


@pytest.fixture
def folder(sound_set, tmp_path):
    return shutil.copytree(sound_set, tmp_path / "set")


def check(capsys, folder, *flags, code=3):
    assert main(["dataset", "check", str(folder), "-j", "1", "--json", *flags]) == code
    told = json.loads(capsys.readouterr().out)
    return [(one["kind"], one["file_name"], one["text"]) for one in told["findings"]]


def edit(folder, change):
    """Let ``change`` edit the table's rows as a spreadsheet would."""
    table = folder / "metadata.csv"
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    rows = change(rows) or rows
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def row_of(rows, file_name):
    return next(row for row in rows if row["file_name"] == file_name)


def one_finding(found):
    assert len(found) == 1, found
    return found[0]


def test_a_sound_data_set_has_no_findings(sound_set, capsys):
    assert check(capsys, sound_set, code=0) == []
    assert main(["dataset", "check", str(sound_set), "-j", "2"]) == 0
    assert "6 pings, nothing found, manifest " in capsys.readouterr().out


def test_a_missing_recording_is_found(folder, capsys):
    (folder / "garage/s1/0001_r48.mcap").unlink()
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("missing", "garage/s1/0001_r48.mcap")
    assert "restore it" in text


def test_a_recording_that_is_not_in_the_table_is_found(folder, capsys):
    edit(folder, lambda rows: rows[1:])
    found = check(capsys, folder, "--no-audio")
    assert ("stray", "garage/s1/0001_r48.mcap") in [one[:2] for one in found]


def test_half_a_recording_is_found(folder, capsys):
    (folder / "garage/s1/0009_r48.mcap.part").touch()
    assert one_finding(check(capsys, folder, "--no-audio"))[0] == "unfinished"


def test_a_changed_recording_is_found(folder, words, capsys):
    (folder / "hall/s1/0001_r48.mcap").unlink()
    place(folder, words["r48", 2], "hall", "s1", 1, "r48", time_s=3601)
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("hash", "hall/s1/0001_r48.mcap")
    assert "sha256 differs" in text


def test_a_damaged_recording_is_found(folder, capsys):
    path = folder / "hall/s1/0001_r48.mcap"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("unreadable", "hall/s1/0001_r48.mcap")
    assert "wrong checksum" in text


def test_a_row_without_hash_is_found(folder, capsys):
    edit(folder, lambda rows: rows[0].update(sha256=""))
    assert one_finding(check(capsys, folder))[0] == "hash"


def test_one_file_under_two_names_is_a_duplicate(folder, capsys):
    copy = "garage/s1/0004_r48.mcap"
    shutil.copy(folder / "garage/s1/0001_r48.mcap", folder / copy)
    edit(folder, lambda rows: [*rows, {**rows[0], "file_name": copy}])
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("duplicate", copy)
    assert text == "the same ping as garage/s1/0001_r48.mcap: keep one of them"


def test_one_ping_in_two_environments_is_a_leak_also_in_a_file_of_its_own(folder, words, capsys):
    """Other bytes of the file, the same of the microphones."""
    row = place(folder, words["r48", 0], "hall", "s1", 4, "r48", time_s=3700)
    write_table(folder, [*open_dataset(folder).rows, row])
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("leak", "hall/s1/0004_r48.mcap")
    assert "it stands in garage and hall" in text


def test_a_label_that_was_edited_differs_from_what_was_recorded(folder, capsys):
    edit(folder, lambda rows: rows[0].update(label="r58"))
    found = check(capsys, folder)
    kind, name, text = one_finding([one for one in found if one[0] != "balance"])
    assert (kind, name) == ("label", "garage/s1/0001_r48.mcap")
    assert "label r58, but recorded as r48" in text


def test_a_wrong_range_has_no_echo(folder, capsys):
    edit(folder, lambda rows: rows[0].update(range_m="1.5"))
    kind, name, text = one_finding(check(capsys, folder))
    assert (kind, name) == ("echo", "garage/s1/0001_r48.mcap")
    assert "no echo at 1.50 m" in text
    assert "is at 2.1" in text
    edit(folder, lambda rows: rows[0].update(quality="weak"))
    assert check(capsys, folder, code=0) == []


def test_an_unknown_label_and_a_landmark_without_range_are_found(folder, capsys):
    def change(rows):
        row_of(rows, "hall/s1/0003_none.mcap")["label"] = "nine"
        rows[0]["range_m"] = ""

    edit(folder, change)
    found = [one for one in check(capsys, folder, "--no-audio") if one[0] == "label"]
    assert "r48 without range_m" in found[0][2]
    assert "label 'nine', expected one of r35" in found[1][2]


def test_a_bad_table_is_reported_by_line_and_the_rest_still_checked(folder, capsys):
    def change(rows):
        rows[0]["range_m"] = "two"
        rows[1]["range_m"] = "1.2"

    edit(folder, change)
    found = [one for one in check(capsys, folder) if one[0] != "balance"]
    assert [one[0] for one in found] == ["table", "echo"]
    assert found[0][2] == "range_m 'two', expected a number of metres, or nothing"
    assert main(["dataset", "check", str(folder), "--no-audio"]) == 3
    assert "metadata.csv:2: garage/s1/0001_r48.mcap: range_m" in capsys.readouterr().out


def test_a_session_in_two_environments_is_a_leak(folder, capsys):
    edit(folder, lambda rows: rows[0].update(environment="hall"))
    found = [one for one in check(capsys, folder, "--no-audio") if one[0] == "leak"]
    _, name, text = one_finding(found)
    assert name == "garage/s1/0001_r48.mcap"
    assert "one session in two environments" in text


def test_environments_recorded_through_each_other_are_a_leak(folder, words, capsys):
    row = place(folder, words["r48", 3], "hall", "s2", 1, "r48", time_s=2.5)
    write_table(folder, [*open_dataset(folder).rows, row])
    found = [one for one in check(capsys, folder) if one[0] == "leak"]
    assert "garage/s1 and hall/s2 were recorded at the same time" in one_finding(found)[2]


def test_a_class_that_an_environment_lacks_is_found(folder, capsys):
    edit(folder, lambda rows: [r for r in rows if r["file_name"] != "hall/s1/0003_none.mcap"])
    found = [one for one in check(capsys, folder, "--no-audio") if one[0] == "balance"]
    assert one_finding(found)[2] == "hall: 0 of none, others 1: record more"


def test_a_dead_microphone_is_one_finding_a_session(folder, words, capsys):
    rows = list(open_dataset(folder).rows)
    for at, (number, label) in enumerate(enumerate(RANGE_M, 1)):
        (folder / rows[at].file_name).unlink()
        heard = words[label, 0] & np.uint32(0xFFFF_FFF7)
        rows[at] = place(folder, heard, "garage", "s1", number, label, time_s=number)
    write_table(folder, rows)
    kind, _, text = one_finding(check(capsys, folder))
    assert kind == "microphones"
    assert text.startswith("garage/s1, 3 of 3 pings: microphone 3 stuck")


def test_pings_of_another_chirp_are_found(folder, words, capsys):
    row = place(
        folder, words["none", 2], "hall", "s1", 4, "none", chirp=INCUMBENT_CHIRP, time_s=3700
    )
    write_table(folder, [*open_dataset(folder).rows, row])
    found = [one for one in check(capsys, folder) if one[0] == "settings"]
    assert "1 with hyperbolic:50000:25000:0.0025, 163840 words" in one_finding(found)[2]


def test_a_folder_that_is_no_data_set_gets_one_line(tmp_path, capsys):
    for part in (["check"], ["stats"], ["relabel", "x"]):
        assert (
            main(["dataset", part[0], str(tmp_path), *part[1:], *["--label=r48"] * len(part[1:])])
            == 1
        )
        assert capsys.readouterr().err.splitlines() == [
            f"ertis: {tmp_path} is no labelled data set: no metadata.csv in it"
        ]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "what"), [("a.mcap", "recording"), ("a.csv", "file")])
def test_a_file_in_the_place_of_a_data_set_is_named_so(tmp_path, capsys, name, what):
    path = tmp_path / name
    path.write_bytes(b"")
    for argv in (["dataset", "check", path], ["evaluate", "--protocol", "paper", path]):
        assert main([*map(str, argv)]) == 1
        said = f"ertis: {path} is a {what}, expected the folder of a data set"
        assert capsys.readouterr().err.splitlines() == [said]


def relabel(folder, *arguments):
    return main(["dataset", "relabel", str(folder), *arguments])


def test_relabel_corrects_the_table_and_check_knows_that_it_is_meant(folder, capsys):
    before = (folder / "metadata.csv").read_text().splitlines()
    name = "garage/s1/0001_r48.mcap"
    assert relabel(folder, name, "--label", "r58", "--yaw", "12.5", "--set", "note=a, b") == 0
    assert capsys.readouterr().out == (
        f"{name}: label r48 -> r58, yaw_deg 0 -> 12.5, note nothing -> a, b\n"
    )
    after = (folder / "metadata.csv").read_text().splitlines()
    assert after[0] == before[0] + ",note"
    assert after[2:] == [line + "," for line in before[2:]]
    found = check(capsys, folder, code=3)
    assert {one[0] for one in found} == {"balance"}
    (entry,) = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert (entry["do"], entry["before"]["label"], entry["after"]["label"]) == (
        "relabel",
        "r48",
        "r58",
    )


def test_relabel_takes_patterns_and_a_dry_run_changes_nothing(folder, capsys):
    before = (folder / "metadata.csv").read_bytes()
    assert relabel(folder, "garage/*", "--quality", "bad", "--dry-run", "--json") == 0
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [item["changes"] for item in told] == [{"quality": ["good", "bad"]}] * 3
    assert (folder / "metadata.csv").read_bytes() == before
    assert relabel(folder, "*_r48.mcap", "--label", "none") == 0
    rows = [row for row in open_dataset(folder).rows if row.file_name.endswith("_r48.mcap")]
    assert [(row.label, math.isnan(row.yaw_rad)) for row in rows] == [("none", True)] * 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere/*", "--label", "r48"], "no recording in"),
        (["*", "--range", "far"], "range_m 'far', expected a number of metres"),
        (["*", "--set", "sha256=0"], "sha256 belongs to the file"),
        (["*", "--set", "note"], "--set note, expected COLUMN=TEXT"),
        (["*", "--label", ""], "label is blank"),
        (["*", "--environment", "../x"], "environment '../x', expected letters, digits, - _ ."),
        (["*", "--set", "session="], "session '', expected letters"),
        (["*", "--set", "note=a\nb"], "expected printable text"),
        (["*"], "nothing to change"),
    ],
)
def test_relabel_refuses_what_it_cannot_do_and_changes_nothing(folder, arguments, said, capsys):
    before = (folder / "metadata.csv").read_bytes()
    assert relabel(folder, *arguments) == 1
    assert said in capsys.readouterr().err
    assert (folder / "metadata.csv").read_bytes() == before


def test_statistics_count_by_environment_and_class(folder, capsys):
    assert main(["dataset", "stats", str(folder), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["counts"]["hall"] == {"none": 1, "r48": 1, "r70": 1}
    assert told["range_m"] == {"known": 6, "least": 2.1, "median": 2.5, "most": 3.0}
    assert told["sources"] == ["live"]
    assert told["manifest_hash"] == open_dataset(folder).manifest_hash
    picture = folder.parent / "stats.png"
    assert main(["dataset", "stats", str(folder), "--plot", str(picture)]) == 0
    out = capsys.readouterr().out
    assert "garage           1      1      1      3" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert main(["dataset", "stats", str(folder), "--plot", "/nowhere/x.png"]) == 1
    assert "cannot write /nowhere/x.png" in capsys.readouterr().err
