"""The examples, run as their users would run them."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import zenoh
from daemon_rig import DEADLINE_S, status_of, wait_for

from ertis_driver.recording import read_recording

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def locator(start_daemon, open_zenoh, free_locator):
    """Of a daemon that publishes events and raw frames, five a second."""
    locator = free_locator()
    daemon = start_daemon("ping_rate_hz: 5\n", "connect: [], raw: true", locator)
    session = open_zenoh(locator)
    wait_for(lambda: daemon.check() and status_of(session).get("events", 0) >= 2)
    return locator


@pytest.fixture
def start_example():
    started = []

    def start(name, *arguments):
        command = [sys.executable, str(EXAMPLES / name), *arguments]
        started.append(
            subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_the_subscriber_prints_landmarks_and_is_as_short_as_it_is_said_to_be(
    locator, start_example
):
    process = start_example("subscribe.py", locator)
    words = process.stdout.readline().split()
    assert words[0] == "t"
    assert words[1] in ("r35", "r48", "r58", "r70")
    assert words[3] == "m"
    assert words[-1] == "sim"
    assert len((EXAMPLES / "subscribe.py").read_text().splitlines()) <= 22


def test_docking_commands_velocities_and_stands_still_when_nothing_is_heard(
    locator, start_example, start_daemon, open_zenoh
):
    for reply in open_zenoh(locator).get("ertis/t/last"):
        event = json.loads(reply.ok.payload.to_bytes())
    sure = [m for m in event["landmarks"] if m["probabilities"][m["class"]] >= 0.5]
    process = start_example("dock.py", sure[0]["class"] if sure else "r58", locator)
    told = json.loads(process.stdout.readline())
    if "range_m" not in told:  # before the first event
        told = json.loads(process.stdout.readline())
    assert 0 <= told["v"] <= 0.3
    assert abs(told["w"]) <= 0.6
    none = start_example("dock.py", "r999", locator)
    assert json.loads(none.stdout.readline()) == {"v": 0.0, "w": 0.0}


def test_docking_ends_standing_still(free_locator, start_example):
    locator = free_locator()
    config = zenoh.Config()
    config.insert_json5("listen/endpoints", json.dumps([locator]))
    config.insert_json5("scouting/multicast/enabled", "false")
    beside = {"class": "r58", "state": "update", "probabilities": {"r58": 0.9}}
    beside |= {"range_m": 0.35, "azimuth_rad": 0.3}
    with zenoh.open(config) as session:
        process = start_example("dock.py", "r58", locator)

        def publish_until_it_ends():
            session.put("ertis/t/landmarks", json.dumps({"landmarks": [beside]}))
            return process.poll() is not None

        wait_for(publish_until_it_ends)
    last = json.loads(process.stdout.read().splitlines()[-1])
    assert last == {"v": 0.0, "w": 0.0, "range_m": 0.35, "reached": True}


def test_the_recorder_records_what_the_sonar_sent(
    locator, start_example, tmp_path, heard_landmarks
):
    out = tmp_path / "copy.mcap"
    process = start_example("record.py", "t", str(out), "3", locator)
    said, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    recording = read_recording(out)
    pings = list(recording)
    assert said == f"{len(pings)} pings of t in {out}\n"
    assert len(pings) >= 5
    (original,) = read_recording(heard_landmarks)
    assert pings[0].frame.words.tobytes() == original.frame.words.tobytes()
    assert recording.info.source == "sim"


def test_the_recorder_says_why_no_ping_came_and_leaves_no_file(
    start_daemon, open_zenoh, free_locator, start_example, tmp_path
):
    locator, out = free_locator(), tmp_path / "copy.mcap"
    daemon = start_daemon("ping_rate_hz: 5\n", "connect: []", locator)
    session = open_zenoh(locator)
    wait_for(lambda: daemon.check() and status_of(session).get("events", 0) >= 2)
    process = start_example("record.py", "t", str(out), "0.5", locator)
    assert process.wait(DEADLINE_S) == 1
    assert process.stderr.read() == "no ping of t in 0.5 s: the daemon needs zenoh.raw: true\n"
    assert not out.exists()


@pytest.mark.parametrize("name", ["dock.py", "record.py"])
def test_without_arguments_an_example_says_what_it_needs(start_example, name):
    process = start_example(name)
    assert process.wait(DEADLINE_S) == 1
    assert process.stderr.read().startswith(f"usage: python {name} ")
