"""``ertis dataset record`` as its user runs it, with a sonar behind a pty."""

import fcntl
import io
import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.dataset import file_sha256, open_dataset
from ertis_driver.emulator import Emulator
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.dataset import random_scene
from ertis_simulator.scene_file import load_scene

DEMO = "simulator/ertis_simulator/scenes/demo.yaml"
PLACE = ["garage", "s1", "ann", "20"]
LABEL = ["r48", "2.26", "-18", "0"]
ERTIS = [sys.executable, "-m", "ertis_daemon.cli"]


@pytest.fixture(scope="module")
def heard():
    """Words of one simulated ping."""
    return random_scene(6, 1).hear(0, 163_840, DEFAULT_CHIRP.samples(450e3))


class OneFrame:
    def __init__(self, words, change=None):
        self.words, self.change = words, change

    def next_frame(self, request):
        return self.words if self.change is None else self.change(self.words.copy(), request)


@pytest.fixture
def port(heard):
    with Emulator(OneFrame(heard), mark="live") as emulator:
        yield emulator.path


class Done:
    def __init__(self, code, captured):
        self.returncode, self.stdout, self.stderr = code, captured.out, captured.err


@pytest.fixture
def record(capsys, monkeypatch):
    """Runs the command with answers on stdin."""

    def run(folder, port, answers, *flags, code=(0, 3)):
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in answers)))
        capsys.readouterr()
        address = f"serial:{port}"
        done = Done(
            main(["dataset", "record", str(folder), "--address", address, *flags]),
            capsys.readouterr(),
        )
        assert done.returncode in code, done.stderr
        return done

    return run


def contents(folder):
    return {
        path.relative_to(folder).as_posix() for path in folder.rglob("*.mcap*") if path.is_file()
    }


def assert_whole(folder):
    """Each recording has its one row, each row its recording, and nothing lies about."""
    dataset = open_dataset(folder)
    assert contents(folder) == {row.file_name for row in dataset.rows}
    for row in dataset.rows:
        assert file_sha256(dataset.path(row)) == row.sha256
        _, ping = dataset.read(row)
        assert ping.truth["label"]["label"] == row.label
    return dataset


def test_a_session_against_the_emulator_end_to_end(tmp_path, record):
    folder = tmp_path / "set"
    scene, pings = load_scene(Path(DEMO)), tmp_path / "pings.mcap"
    with RecordingWriter(pings, RecordingInfo("sim", DEFAULT_CHIRP, 163_840, 20.0)) as writer:
        for number in range(4):
            heard = scene.hear(number, 163_840, DEFAULT_CHIRP.samples(450e3))
            writer.write(PdmFrame(heard, number, number))
    emulator = subprocess.Popen(
        [*ERTIS, "emulate", "--replay", str(pings)], stdout=subprocess.PIPE, text=True
    )
    try:
        port = emulator.stdout.readline().strip()
        words = ["", "r 1.0 p", "u", "r35 r 1.67 b 22 t 5 p", "none", "p", "q"]
        done = record(folder, port, [*PLACE, *LABEL, *words], "--json")
    finally:
        emulator.terminate()
        emulator.communicate()
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [item["label"] for item in told] == ["r48", "r48", "r35", "none"]
    assert [item["quality"] for item in told] == ["good", "weak", "good", "good"]
    assert told[0]["echo_db"] > 15 > 10 > told[1]["echo_db"]
    assert "no echo at 1.00 m" in told[1]["notes"][0]
    assert "clearest toward there is at 3.7" in done.stderr
    assert "4 simulated pings recorded, 1 undone; 3 in the data set" in done.stderr
    assert done.returncode == 0
    dataset = assert_whole(folder)
    assert [row.file_name for row in dataset.rows] == [
        "garage/s1/0001_r48.mcap",
        "garage/s1/0002_r35.mcap",
        "garage/s1/0003_none.mcap",
    ]
    info, ping = dataset.read(dataset.rows[1])
    assert info.source == "sim"
    assert info.temperature_c == 20
    assert info.firmware == "2.3.4"
    assert ping.truth["label"] == {
        "label": "r35",
        "range_m": 1.67,
        "azimuth_deg": 22.0,
        "yaw_deg": 5.0,
        "environment": "garage",
        "session": "s1",
        "operator": "ann",
    }


def test_enter_keeps_what_was_said_also_in_the_next_run(tmp_path, port, record):
    folder = tmp_path / "set"
    record(folder, port, [*PLACE, *LABEL, "", ""])
    record(folder, port, ["", "", "", "", "", "", "", "", "", "e", "hall", "", "", "", ""])
    rows = assert_whole(folder).rows
    assert [row.file_name for row in rows] == [
        *(f"garage/s1/{number:04d}_r48.mcap" for number in (1, 2, 3)),
        "hall/s1/0001_r48.mcap",
    ]
    assert {(row.range_m, row.operator) for row in rows} == {(2.26, "ann")}
    info, _ = open_dataset(folder).read(rows[3])
    said = json.loads(info.label)  # as it was recorded, whatever the table is corrected to
    assert (said["label"], said["range_m"], said["environment"]) == ("r48", 2.26, "hall")
    assert (info.operator, info.place) == ("ann", "hall/s1")


def test_a_wrong_word_changes_nothing_and_pings_nothing(tmp_path, port, record):
    folder = tmp_path / "set"
    words = ["r48 r x p", "p r 3", "l ../x", "t 400 p", "rr", "r", "p", "r 2.26 p"]
    done = record(folder, port, ["../up", *PLACE, "r48", "", "2,5", "2.26", "", "", *words])
    for said in (
        "environment '../up', expected letters",
        "a landmark's range must be known",
        "'2,5', expected a number of metres with a decimal point",
        "r x: expected a number of metres",
        "p comes last",
        "label '../x', expected letters",
        "t 400: expected degrees from -180 to 180",
        "'rr' is not understood: did you mean",
        "the range of r48 must be known",
    ):
        assert said in done.stderr, said
    assert len(assert_whole(folder).rows) == 1


def test_a_dead_microphone_and_one_that_clips_are_named_at_once(tmp_path, heard, record):
    def change(words, request):
        words &= np.uint32(~(1 << 5) & 0xFFFFFFFF)
        words[60_000:60_040] |= np.uint32(1 << 9)
        return words

    with Emulator(OneFrame(heard, change)) as emulator:
        done = record(tmp_path / "set", emulator.path, [*PLACE, "none", "", "", "p"])
    assert done.returncode == 3
    assert "microphone 5 stuck" in done.stderr
    assert "microphone 9 clips on an echo" in done.stderr
    (row,) = assert_whole(tmp_path / "set").rows
    assert row.quality.split() == ["microphones", "clipped"]


def test_a_silent_emitter_is_named_at_once(tmp_path, record):
    scene = random_scene(6, 1)
    with Emulator(OneFrame(scene.hear(0, 163_840, None))) as emulator:
        done = record(tmp_path / "set", emulator.path, [*PLACE, *LABEL, "p"])
    assert "the chirp was not heard on its way out" in done.stderr
    assert assert_whole(tmp_path / "set").rows[0].quality == "silent weak"


def test_answers_that_end_early_are_no_error_and_undo_reaches_over_runs(tmp_path, port, record):
    folder = tmp_path / "set"
    assert record(folder, port, PLACE[:2]).returncode == 0
    record(folder, port, [*PLACE, *LABEL, "p", "p"])
    done = record(folder, port, [*PLACE, *LABEL, "u", "u", "u", "r35 p"])
    assert "nothing to undo" in done.stderr
    assert [row.file_name for row in assert_whole(folder).rows] == ["garage/s1/0001_r35.mcap"]


def test_a_folder_of_other_things_is_refused(tmp_path, port, record):
    (tmp_path / "holiday.jpg").touch()
    done = record(tmp_path, port, [*PLACE, *LABEL, "p"], code=(1,))
    assert "is not empty and no data set" in done.stderr
    assert contents(tmp_path) == set()


def test_a_table_with_a_mistake_is_refused_not_rewritten(tmp_path, port, record):
    folder = tmp_path / "set"
    record(folder, port, [*PLACE, *LABEL, "p"])
    table = folder / "metadata.csv"
    wrong = table.read_text().replace("2.2600", "2,26")
    table.write_text(wrong)
    done = record(folder, port, [*PLACE, *LABEL, "p"], code=(1,))
    assert f"ertis: {table}:2: " in done.stderr
    assert table.read_text() == wrong


@pytest.mark.parametrize("known", [False, True])
def test_a_run_without_a_ping_leaves_nothing(tmp_path, port, record, known):
    folder = tmp_path / "new" / "set"
    if known:
        folder.mkdir(parents=True)
    record(folder, tmp_path / "no-port", [], code=(1,))
    record(folder, port, PLACE[:2])
    assert list(tmp_path.rglob("*")) == [folder.parent, folder] * known


def test_two_at_a_time_are_one_too_many(tmp_path, heard, record):
    folder = tmp_path / "set"
    with Emulator(OneFrame(heard)) as first, Emulator(OneFrame(heard)) as second:
        command = [*ERTIS, "dataset", "record", str(folder), "--address", f"serial:{first.path}"]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as running:
            assert running.stderr.read(5) == "envir"
            done = record(folder, second.path, [], code=(1,))
            running.stdin.close()
            running.stderr.read()
    assert "is being written by another process" in done.stderr


@pytest.fixture
def begun(tmp_path, port, record):
    """A data set of two pings, and what a crash may leave of a third."""
    folder = tmp_path / "set"
    record(folder, port, [*PLACE, *LABEL, "p", "r58 p", "r70 p"])
    rows = open_dataset(folder).rows
    table = (folder / "metadata.csv").read_text().splitlines(keepends=True)
    return folder, rows, table


@pytest.fixture
def resume(record):
    def run(folder, port):
        done = record(folder, port, [])
        return [line for line in done.stderr.splitlines() if line.startswith("resumed: ")]

    return run


def test_a_ping_whose_row_was_not_written_any_more_is_taken_in(begun, port, resume):
    folder, rows, table = begun
    (folder / "metadata.csv").write_text("".join(table[:-1]))
    said = resume(folder, port)
    assert said == [f"resumed: {rows[2].file_name} was not in the table yet: taken in as r70"]
    assert assert_whole(folder).rows == rows
    assert resume(folder, port) == []


def test_without_table_and_journal_the_recordings_tell(begun, port, resume):
    folder, rows, _ = begun
    for name in ("metadata.csv", "journal.jsonl"):
        (folder / name).write_text("file_name,label\n" if name == "metadata.csv" else "")
    resume(folder, port)
    again = assert_whole(folder).rows
    assert [row.label for row in again] == ["r48", "r58", "r70"]
    assert [row.sha256 for row in again] == [row.sha256 for row in rows]


def test_half_a_recording_is_removed_and_its_number_used_again(begun, port, resume, record):
    folder, _, _ = begun
    part = folder / "garage/s1/0004_r35.mcap.part"
    part.write_bytes(b"half")
    with (folder / "journal.jsonl").open("ab") as file:
        file.write(b'{"time": "2026-01-01T00:00:00Z", "do": "add", "file_na')
    assert "0004_r35.mcap.part was not whole yet" in resume(folder, port)[0]
    record(folder, port, [*PLACE, *LABEL, "p", "u", "none p"])
    assert len(assert_whole(folder).rows) == 4


@pytest.mark.parametrize("row_is_gone", [False, True])
def test_an_undo_that_was_cut_short_is_done_to_its_end(begun, port, row_is_gone, resume):
    folder, rows, table = begun
    entry = {"do": "undo", "file_name": rows[2].file_name, "sha256": rows[2].sha256}
    with (folder / "journal.jsonl").open("a") as file:
        file.write(json.dumps(entry) + "\n")
    if row_is_gone:
        (folder / "metadata.csv").write_text("".join(table[:-1]))
    assert resume(folder, port) == [f"resumed: {rows[2].file_name} was being undone: removed"]
    assert assert_whole(folder).rows == rows[:2]


def test_a_foreign_recording_is_left_alone_and_named(begun, port, resume):
    folder, rows, _ = begun
    (folder / "garage/s1/0009_r48.mcap").write_bytes(b"hello")
    assert "has no label: left alone" in resume(folder, port)[0]
    assert open_dataset(folder).rows == rows


def test_sigkill_at_any_moment_loses_no_acknowledged_ping_and_doubles_none(tmp_path, port, resume):
    folder = tmp_path / "set"
    acknowledged = set()
    for turn in range(4):
        running = subprocess.Popen(
            [*ERTIS, "dataset", "record", str(folder), "--address", f"serial:{port}", "--json"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        running.stdin.write("\n".join([*PLACE, *LABEL, *["p"] * 300, ""]))
        running.stdin.flush()
        acknowledged.add(json.loads(running.stdout.readline())["sha256"])
        time.sleep(0.05 + 0.037 * turn)
        running.send_signal(signal.SIGKILL)
        rest, _ = running.communicate()
        acknowledged |= {
            json.loads(line)["sha256"]
            for line in rest.splitlines(keepends=True)
            if line.endswith("\n")
        }
    resume(folder, port)
    rows = assert_whole(folder).rows
    assert acknowledged <= {row.sha256 for row in rows}
    assert len(rows) - len(acknowledged) <= 4


def own_terminal():
    """In the child: its standard input is its terminal, and Ctrl-C there counts."""
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_it_works_on_a_terminal_and_ctrl_c_keeps_what_is_recorded(tmp_path, port):
    folder = tmp_path / "set"
    master, slave = pty.openpty()
    running = subprocess.Popen(
        [*ERTIS, "dataset", "record", str(folder), "--address", f"serial:{port}"],
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        preexec_fn=own_terminal,
    )
    os.close(slave)
    shown = b""

    def until(mark):
        nonlocal shown
        deadline = time.monotonic() + 60
        while mark not in shown:
            assert time.monotonic() < deadline, shown
            if select.select([master], [], [], 0.2)[0]:
                shown += os.read(master, 4096)
        shown = shown.split(mark, 1)[1]

    for prompt, answer in zip(
        [
            b"environment: ",
            b"session [s1]: ",
            b"operator: ",
            b"degrees C [20]: ",
            b"none): ",
            b"vertex): ",
            b"left) [not known]: ",
            b"left) [not known]: ",
        ],
        ["garage", "", "ann", "", "r48", "2.26", "-18", ""],
        strict=True,
    ):
        until(prompt)
        os.write(master, answer.encode() + b"\n")
    until(b"0001 r48 2.26 m at -18.0 deg > ")
    os.write(master, b"\n")
    until(b"garage/s1/0001_r48.mcap")
    until(b"0002 r48")
    os.write(master, b"\x03")
    assert running.wait(30) == 130
    os.close(master)
    assert len(assert_whole(folder).rows) == 1
