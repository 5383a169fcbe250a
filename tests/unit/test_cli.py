import json
import os
import subprocess
import sys

import pytest

from ertis_daemon.cli import COMMANDS, main
from ertis_daemon.cli.monitor import format_event
from ertis_daemon.cli.monitor_table import Board


def in_process_of_its_own(code):
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=False
    )


def test_help_names_every_command_and_imports_nothing_heavy():
    code = (
        "import sys; from ertis_daemon.cli import main\n"
        "try: main(['--help'])\n"
        "except SystemExit as e: assert e.code == 0\n"
        "heavy = {'numpy', 'scipy', 'zenoh', 'yaml', 'serial'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    done = in_process_of_its_own(code)
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    assert end.value.code == 0
    assert f"ertis {name}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "argv",
    [[], ["nonsense"], ["run", "--nonsense"], ["emulate"], ["monitor", "--count", "x"]],
)
def test_wrong_usage_is_exit_code_2(argv, capsys):
    with pytest.raises(SystemExit) as end:
        main(argv)
    assert end.value.code == 2
    assert "usage: ertis" in capsys.readouterr().err


def test_check_config_prints_an_example_that_it_accepts(tmp_path, capsys):
    assert main(["check-config"]) == 0
    path = tmp_path / "e.yaml"
    path.write_text(capsys.readouterr().out)
    assert main(["check-config", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: ok\n"
    assert main(["check-config", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["device"]["name"] == "ertis"


def test_each_error_in_a_configuration_is_one_line_and_exit_code_1(tmp_path, capsys):
    path = tmp_path / "e.yaml"
    path.write_text("pingrate: 1\nqueue_size: 0\n")
    assert main(["check-config", str(path)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        f"ertis: {path}:1:1: pingrate: unknown key, did you mean 'ping_rate_hz'?",
        f"ertis: {path}:2:13: queue_size: 0, expected 1 to 64",
    ]


@pytest.mark.parametrize("name", ["there", "there/front"])
def test_a_folder_for_recordings_that_cannot_be_is_refused(tmp_path, capsys, name):
    (tmp_path / "there").write_text("a file")
    path = tmp_path / "e.yaml"
    path.write_text(f"record: {{folder: {tmp_path}/{name}}}\n")
    assert main(["check-config", str(path)]) == 1
    said = f"ertis: record.folder of sonar 'ertis': {tmp_path}/there is no folder: name another"
    assert capsys.readouterr().err.splitlines() == [said]
    path.write_text(f"record: {{folder: {tmp_path}/new/front}}\n")
    assert main(["check-config", str(path)]) == 0


def test_a_flag_is_checked_like_the_file(capsys):
    assert main(["run", "--device", "a/b"]) == 1
    assert "device.name: 'a/b', expected a Zenoh key chunk" in capsys.readouterr().err


def test_the_daemon_imports_nothing_that_costs_it_seconds_or_memory():
    code = (
        "import sys\n"
        "from ertis_daemon.cli import main\n"
        "from ertis_daemon.serving.daemon import Daemon\n"
        "import ertis_detector.detector, ertis_detector.model, ertis_detector.tracker\n"
        "heavy = {'scipy.signal', 'scipy.stats', 'sklearn', 'numba', 'matplotlib'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    done = in_process_of_its_own(code)
    assert done.returncode == 0, done.stderr


def test_the_live_table_shows_what_each_sonar_said_last():
    board = Board("tcp/robot:1")
    assert board.lines(0.0)[0].startswith("no sonar heard of at tcp/robot:1 yet; --connect wants")
    mark = {
        "class": "r48",
        "probabilities": {"r48": 0.9},
        "azimuth_rad": 0.1,
        "elevation_rad": None,
        "state": "update",
    }
    far = {**mark, "track_id": 1, "range_m": 3.0}
    near = {**mark, "track_id": 2, "range_m": 1.0}
    board.take_event({"device": "b", "source": "sim", "landmarks": [far, near]}, 0.0)
    status = {"state": "running", "source": "live", "ping_rate_hz": 27.5, "pings_lost": 3}
    trouble = {"microphones_faulty": {"5": "stuck"}, "outputs_failing": {"ROS 2 events": "why"}}
    board.take_status("a", {**status, **trouble}, 0.0)
    lines = board.lines(1.0)
    assert lines[0].startswith("a  running  live  |  27.5 pings/s  |  3 lost")
    assert lines[0].endswith("microphones 5 stuck  |  ROS 2 events fail: why")
    assert lines[1] == "  no landmark"
    assert lines[3] == "b  sim"
    assert " 1.000 m" in lines[4]
    assert " 3.000 m" in lines[5]
    board.take_event(
        {"device": "b", "source": "sim", "landmarks": [{**near, "state": "lost"}]}, 1.0
    )
    assert not any(" 1.000 m" in line for line in board.lines(1.1)), "lost"
    assert not any(" 3.000 m" in line for line in board.lines(2.1)), "stale"
    assert board.lines(5.0)[0] == "a  SILENT for 5 s"
    with pytest.raises(KeyError):
        board.take_event({"device": "c"}, 0.0)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--count", "-1"], "--count -1, expected 0 or more"),
        (["--device", "a*"], "--device 'a*', expected one sonar's name: leave it out for all"),
        (["--device", ""], "--device '', expected one sonar's name: leave it out for all"),
    ],
)
def test_what_cannot_be_monitored_is_one_clear_line(capsys, argv, said):
    assert main(["monitor", *argv]) == 1
    assert capsys.readouterr().err.splitlines() == [f"ertis: {said}"]


def test_truth_without_a_scene_is_refused(tmp_path, capsys):
    truth = str(tmp_path / "t.jsonl")
    assert main(["emulate", "--replay", "x.mcap", "--truth", truth]) == 1
    assert capsys.readouterr().err.startswith("ertis: --truth is for --scene")


def test_a_reader_that_goes_away_ends_it_in_silence():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as stdout:
        done = subprocess.run(
            [sys.executable, "-m", "ertis_daemon.cli", "check-config"],
            stdout=stdout,
            stderr=subprocess.PIPE,
            timeout=30,
            check=False,
        )
    assert done.stderr == b""


def test_an_event_is_one_line_a_landmark_with_question_marks_for_null():
    item = {
        "track_id": 4,
        "state": "new",
        "class": "r48",
        "probabilities": {"r48": 0.934},
        "range_m": 1.2345,
        "azimuth_rad": 0.1,
        "elevation_rad": None,
    }
    event = {"ping_time_ns": 1_123_000_000, "device": "d", "source": "sim", "landmarks": [item] * 2}
    lines = format_event(event)
    assert len(lines) == 2
    assert ":01.123  d" in lines[0]
    assert "r48  93 %   1.234 m    +5.7 ? deg  track 4 new     sim" in lines[0]
