"""Labelled data sets as a library: the table, its errors, the hash that names the whole."""

import dataclasses
import hashlib
import math
import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver.dataset import (
    COLUMNS,
    METADATA,
    DatasetRow,
    manifest_hash,
    open_dataset,
    path_in_dataset,
    read_table,
    write_table,
)
from ertis_driver.dataset_table import check_file_name, format_table, parse_table
from ertis_driver.errors import DatasetError, RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter

HEAD = ",".join(COLUMNS)
HASH = "ab" * 32
GOOD = f"garage/s1/0001_r48.mcap,r48,3.2,-12.5,30,garage,s1,ann,{HASH},good"


def written(folder, *lines):
    folder.mkdir(exist_ok=True)
    (folder / METADATA).write_text("\n".join(lines) + "\n")
    return folder


def problems(folder):
    with pytest.raises(DatasetError) as caught:
        open_dataset(folder)
    return str(caught.value).splitlines()


def test_a_row_is_read_in_metres_and_radians(tmp_path):
    dataset = open_dataset(written(tmp_path, HEAD, GOOD))
    (row,) = dataset.rows
    assert row == DatasetRow(
        "garage/s1/0001_r48.mcap",
        "r48",
        3.2,
        math.radians(-12.5),
        math.radians(30),
        "garage",
        "s1",
        "ann",
        HASH,
        "good",
    )
    assert row.line == 2
    assert row.values()["azimuth_deg"] == -12.5
    assert dataset.path(row) == tmp_path / "garage/s1/0001_r48.mcap"


def test_a_blank_number_is_nan_and_stays_blank(tmp_path):
    folder = written(tmp_path, HEAD, f"a.mcap,none,,,,,,,{HASH},")
    (row,) = open_dataset(folder).rows
    assert math.isnan(row.range_m)
    assert math.isnan(row.azimuth_rad)
    assert math.isnan(row.yaw_rad)
    assert row.values()["yaw_deg"] is None
    before = (folder / METADATA).read_bytes()
    write_table(folder, [row])
    assert (folder / METADATA).read_bytes() == before


def test_unknown_columns_and_untouched_text_are_kept(tmp_path):
    head = "file_name,label,weather,azimuth_deg,range_m,sha256"
    lines = f'a.mcap,r35,"wet, cold",1.23456,+3.50,{HASH}', f"b.mcap,r35,dry,2,4,{HASH}"
    dataset = open_dataset(written(tmp_path, head, *lines))
    assert dataset.rows[0].extra == {"weather": "wet, cold"}
    changed = dataclasses.replace(dataset.rows[1], range_m=4.25)
    write_table(tmp_path, [dataset.rows[0], changed], dataset.columns)
    assert (tmp_path / METADATA).read_text().splitlines() == [
        head,
        lines[0],
        f"b.mcap,r35,dry,2,4.2500,{HASH}",
    ]


def test_a_column_that_a_row_comes_to_need_is_added(tmp_path):
    dataset = open_dataset(written(tmp_path, "file_name,label,sha256", f"a.mcap,r35,{HASH}"))
    row = dataclasses.replace(dataset.rows[0], range_m=1.0, extra={"weather": "wet"})
    text = format_table([row], dataset.columns)
    assert text.splitlines()[0] == "file_name,label,sha256,range_m,weather"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (GOOD.replace("3.2", "three"), "range_m 'three', expected a number of metres"),
        (GOOD.replace("3.2", '"3,2"'), "range_m '3,2', expected a number of metres with a decimal"),
        (GOOD.replace("3.2", "inf"), "range_m 'inf', expected a finite number"),
        (GOOD.replace("3.2", "nan"), "range_m 'nan', expected a finite number"),
        (GOOD.replace("3.2", "-3.2"), "range_m '-3.2', expected metres above 0"),
        (GOOD.replace("-12.5", "200"), "azimuth_deg '200', expected degrees from -180 to 180"),
        (GOOD.replace(",r48,", ",,"), "label '', expected r35 and the like, or none"),
        (GOOD.replace(HASH, "123"), "sha256 '123', expected 64 hexadecimal digits"),
        (GOOD + ",more", "11 cells, expected 10 as in the first line"),
        (GOOD.replace("garage/s1/", "../../etc/"), "leads out of the folder"),
        (GOOD.replace("garage/s1/", "/etc/"), "leads out of the folder"),
        (GOOD.replace("garage/s1/", "a\\..\\"), "expected folders and names with / between them"),
        (GOOD.replace("garage/s1/", "a//"), "expected a plain path"),
        (GOOD.replace("garage/s1/0001_r48.mcap", ""), "file_name is blank"),
        (GOOD.replace("good", "x" * 5000), "a cell of more than 4096 characters"),
        ('"never closed', "this is not CSV"),
    ],
)
def test_a_bad_line_is_named_with_file_and_line(tmp_path, line, said):
    (found,) = problems(written(tmp_path, HEAD, GOOD.replace("0001", "0000"), line))
    assert found.startswith(f"{tmp_path / METADATA}:3: ")
    assert said in found


def test_all_bad_lines_are_named_at_once_but_not_without_end(tmp_path):
    bad = [f"{number}.mcap,,x,,,,,,," for number in range(30)]
    found = problems(written(tmp_path, HEAD, *bad))
    assert len(found) == 21
    assert found[0].endswith("metadata.csv:2: label '', expected r35 and the like, or none")
    assert "metadata.csv:2: range_m 'x'" in found[1]
    assert found[-1].startswith("and 40 more")


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("", "the table is empty"),
        ("file_name;label;range_m", "separated by ';', expected ','"),
        ("label,file_name", "first column is 'label', expected 'file_name'"),
        ("file_name,lable", "no column 'label'; is it 'lable'?"),
        ("file_name,label,label", "2 columns are called 'label'"),
    ],
)
def test_a_bad_first_line_is_named(tmp_path, head, said):
    (found,) = problems(written(tmp_path, head))
    assert found.startswith(f"{tmp_path / METADATA}:1: ")
    assert said in found


def test_one_recording_twice_in_the_table_is_an_error(tmp_path):
    (found,) = problems(written(tmp_path, HEAD, GOOD, GOOD.replace("r48,3", "r58,3")))
    assert ":3: garage/s1/0001_r48.mcap stands in line 2 already" in found


def test_the_rest_of_a_bad_table_is_still_read(tmp_path):
    table = read_table(written(tmp_path, HEAD, GOOD, "b.mcap,,,,,,,,,"))
    assert [row.file_name for row in table.rows] == ["garage/s1/0001_r48.mcap"]
    assert [(one.line, one.file_name) for one in table.problems] == [(3, "b.mcap")]


def test_a_folder_without_table_and_a_table_that_is_no_text_get_one_line(tmp_path):
    assert problems(tmp_path) == [f"{tmp_path} is no labelled data set: no metadata.csv in it"]
    (tmp_path / METADATA).write_bytes(b"file_name,label\n\xff\xfe")
    assert problems(tmp_path) == [f"{tmp_path / METADATA}:2: no UTF-8 text: save it as UTF-8"]


def test_a_table_saved_by_a_spreadsheet_is_read(tmp_path):
    (tmp_path / METADATA).write_bytes(f"\ufeff{HEAD}\r\n{GOOD}\r\n,,,,,,,,,\r\n".encode())
    assert len(open_dataset(tmp_path).rows) == 1


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    folder = written(tmp_path / "set", HEAD, GOOD)
    (tmp_path / "elsewhere").mkdir()
    (folder / "garage").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DatasetError, match="is a link out of"):
        path_in_dataset(folder, "garage/s1/0001_r48.mcap")
    with pytest.raises(DatasetError, match="leads out of the folder"):
        write_table(folder, [DatasetRow("../x.mcap", "r48")])


def test_the_hash_follows_what_learning_sees_and_nothing_else(tmp_path):
    rows = [DatasetRow(f"{n}.mcap", "r48", 1.0 + n, 0.1, 0.2, sha256=HASH) for n in range(5)]
    first = manifest_hash(tmp_path, rows)
    shuffled = [
        dataclasses.replace(row, file_name=f"x/{row.file_name}", operator="bob", extra={"a": "b"})
        for row in random.Random(1).sample(rows, 5)
    ]
    assert manifest_hash(tmp_path, shuffled) == first
    changes = (
        {"label": "r58"},
        {"range_m": 9.0},
        {"azimuth_rad": 0.3},
        {"yaw_rad": float("nan")},
        {"environment": "hall"},
        {"session": "s2"},
        {"sha256": "cd" * 32},
        {"quality": "bad"},
    )
    others = {
        manifest_hash(tmp_path, [*rows[1:], dataclasses.replace(rows[0], **change)])
        for change in changes
    }
    assert len(others | {first}) == len(changes) + 1
    assert manifest_hash(tmp_path, rows[1:]) != first


def test_the_hash_survives_writing_and_reading(tmp_path):
    rng = random.Random(2)
    rows = [
        DatasetRow(f"{n}.mcap", "r48", rng.uniform(0, 6), rng.uniform(-1, 1), -1e-6, sha256=HASH)
        for n in range(200)
    ]
    write_table(tmp_path, rows)
    assert open_dataset(tmp_path).manifest_hash == manifest_hash(tmp_path, rows)


def test_a_file_without_hash_in_the_table_is_hashed_itself(tmp_path):
    folder = written(tmp_path, HEAD, GOOD.replace(HASH, ""))
    (found,) = problems(folder)
    assert "no recording" in found
    path = folder / "garage/s1/0001_r48.mcap"
    path.parent.mkdir(parents=True)
    path.write_bytes(b"anything")
    unhashed = open_dataset(folder)
    known = hashlib.sha256(b"anything").hexdigest()
    row = dataclasses.replace(unhashed.rows[0], sha256=known)
    assert manifest_hash(folder, [row]) == unhashed.manifest_hash


def test_a_table_that_the_disk_does_not_take_leaves_the_old_one(tmp_path):
    folder = written(tmp_path, HEAD, GOOD)
    before = (folder / METADATA).read_bytes()
    part = folder / f"{METADATA}.part"
    part.symlink_to("/dev/full")
    with pytest.raises(DatasetError, match=r"cannot write .*: No space left on device"):
        write_table(folder, [DatasetRow("b.mcap", "r35")])
    assert (folder / METADATA).read_bytes() == before
    assert [path.name for path in folder.iterdir()] == [METADATA]


def test_a_row_s_recording_is_read_if_it_holds_one_ping(tmp_path):
    folder = written(tmp_path, HEAD, f"one.mcap,none,,,,,,,{HASH},", f"two.mcap,none,,,,,,,{HASH},")
    words = np.zeros(32768, np.uint32)
    for name, count in (("one", 1), ("two", 2)):
        with RecordingWriter(folder / f"{name}.mcap", RecordingInfo("sim", None, 32768)) as writer:
            for index in range(count):
                writer.write(PdmFrame(words, index + 7, 0))
    dataset = open_dataset(folder)
    info, ping = dataset.read(dataset.rows[0])
    assert info.source == "sim"
    assert ping.frame.ping_index == 7
    with pytest.raises(RecordingError, match="holds several pings, expected one"):
        dataset.read(dataset.rows[1])


CELL = st.text(st.characters(codec="utf-8"), max_size=20)


def as_table(cells):
    return "file_name,label,range_m\n" + ",".join(cells)


@given(
    st.text(st.characters(codec="utf-8"), max_size=300) | st.lists(CELL, max_size=9).map(as_table)
)
def test_no_text_breaks_the_table_s_reader(text):
    table = parse_table(text)
    for row in table.rows:
        assert not check_file_name(row.file_name)
    assert table.rows == () or table.columns[0] == "file_name"


@given(
    CELL,
    st.floats(0.001, 100),
    st.floats(-math.pi, math.pi),
    st.dictionaries(st.sampled_from(["weather", "note"]), CELL),
)
def test_what_is_written_is_read_again(operator, range_m, azimuth_rad, extra):
    row = DatasetRow("a/b.mcap", "r48", range_m, azimuth_rad, operator=operator, extra=extra)
    table = parse_table(format_table([row]))
    assert not table.problems
    (again,) = table.rows
    assert again.operator == operator.replace("\r", "\n").strip()
    for name, text in extra.items():
        assert again.extra.get(name, "") == text.replace("\r", "\n")
    assert again.range_m == pytest.approx(range_m, abs=0.51e-4)
    assert again.azimuth_rad == pytest.approx(azimuth_rad, abs=math.radians(0.0051))
    assert format_table([again], table.columns) == format_table(table.rows, table.columns)
