"""``ertis run`` as a process: signals, systemd, routers and disks that fail."""

import contextlib
import json
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import time

import pytest
import zenoh
from daemon_rig import DEADLINE_S, status_of, wait_for
from zenoh import ext

from ertis_driver.recording import read_recording

STOP_S = 5.0

ROUTER = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config):
    print("up", flush=True)
    time.sleep(1000)
"""

FROZEN = """
import json, sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    subscriber = session.declare_subscriber("ertis/t/**", zenoh.handlers.RingChannel(2))
    subscriber.recv()
    print("up", flush=True)
    time.sleep(1000)
"""


def advanced(session):
    return ext.declare_advanced_subscriber(
        session,
        "ertis/t/landmarks",
        zenoh.handlers.FifoChannel(10_000),
        history=ext.HistoryConfig(detect_late_publishers=True),
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def test_no_event_is_lost_when_the_router_is_killed_and_comes_back(
    start_daemon, start_program, open_zenoh, free_locator
):
    locator = free_locator()
    router = start_program(ROUTER, locator)
    daemon = start_daemon("ping_rate_hz: 6\n", f"connect: ['{locator}']")
    session = open_zenoh(locator)
    subscriber = advanced(session)
    indices = []

    def drain():
        daemon.check()
        while (sample := subscriber.try_recv()) is not None:
            indices.append(json.loads(sample.payload.to_bytes())["ping_index"])
        return len(indices)

    wait_for(lambda: drain() >= 10)
    router.process.kill()
    router.process.wait()
    before = drain()
    time.sleep(1.5)
    drain()
    assert len(indices) <= before + 3, "the events came by the router, and by it alone"
    start_program(ROUTER, locator)
    wait_for(lambda: drain() >= before + 20)
    assert sorted(indices) == list(range(indices[0], indices[0] + len(indices)))
    wait_for(lambda: status_of(session)["routers"] == 1)
    status = status_of(session)
    assert status["pings_lost"] == status["timeouts"] == 0


def test_a_frozen_subscriber_holds_up_neither_pings_nor_other_subscribers(
    start_daemon, start_program, open_zenoh, free_locator
):
    locator = free_locator()
    daemon = start_daemon("ping_rate_hz: 8\n", "connect: [], raw: true", locator)
    session = open_zenoh(locator)
    wait_for(lambda: daemon.check() and status_of(session).get("events", 0) >= 3)
    frozen = start_program(FROZEN, locator)
    frozen.process.send_signal(signal.SIGSTOP)
    before = status_of(session)
    time.sleep(4.0)
    after = status_of(session)
    assert after["pings_heard"] - before["pings_heard"] >= 12, "8 a second, on a busy machine"
    assert after["pings_lost"] == after["timeouts"] == after["pings_failed"] == 0
    assert after["events"] > before["events"]


@pytest.mark.parametrize("moment_s", [0.05, 0.6, 1.5])
def test_sigterm_at_any_moment_ends_it_soon(start_daemon, moment_s):
    daemon = start_daemon()
    time.sleep(moment_s)
    took_s, _ = daemon.stop()
    assert took_s < STOP_S
    assert daemon.process.returncode in (0, -signal.SIGTERM), daemon.log.read_text()


def test_sigterm_while_it_pings_leaves_the_device_idle_and_the_amplifier_off(
    start_daemon, landmark_sonar
):
    daemon = start_daemon()
    daemon.wait_for("is open")
    wait_for(lambda: landmark_sonar.state.ping_index > 3)
    assert landmark_sonar.state._held["K"] == 1
    took_s, out = daemon.stop()
    assert took_s < STOP_S
    assert daemon.process.returncode == 0
    assert json.loads(out)["pings_heard"] > 0
    assert landmark_sonar.state._held["K"] == 0
    index = landmark_sonar.state.ping_index
    time.sleep(0.3)
    assert landmark_sonar.state.ping_index == index


def test_sigkill_leaves_nothing_that_stops_the_next_start(
    start_daemon, landmark_sonar, open_zenoh, free_locator
):
    locator = free_locator()
    first = start_daemon("ping_rate_hz: 10\n", locator=locator)
    wait_for(lambda: first.check() and landmark_sonar.state.ping_index > 3)
    first.process.kill()
    first.process.wait()
    index = landmark_sonar.state.ping_index
    second = start_daemon("ping_rate_hz: 10\n", locator=locator)
    wait_for(lambda: second.check() and landmark_sonar.state.ping_index > index + 3)
    assert status_of(open_zenoh(locator))["state"] == "running"


def test_systemd_hears_of_it_and_sighup_reloads(start_daemon, tmp_path, open_zenoh, free_locator):
    path, locator = tmp_path / "notify", free_locator()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(os.fspath(path))
        systemd.settimeout(DEADLINE_S)
        environment = {"NOTIFY_SOCKET": os.fspath(path), "WATCHDOG_USEC": "600000"}
        daemon = start_daemon("ping_rate_hz: 10\n", locator=locator, environment=environment)
        told = []

        def hear(text):
            while not any(text in line for line in told):
                told.append(systemd.recv(4096).decode())

        hear("READY=1")
        hear("STATUS=t: running")
        del told[:]
        hear("WATCHDOG=1")
        file = tmp_path / "ertis.yaml"
        file.write_text(file.read_text() + "temperature_c: 5\ndetector: {min_probability: 2}\n")
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait_for("not reloaded: .*min_probability: 2.0, expected 0 to 1")
        file.write_text(file.read_text().replace("min_probability: 2", "min_probability: 0.1"))
        daemon.process.send_signal(signal.SIGHUP)
        daemon.wait_for("reloaded: t: opened again, for detector.min_probability, temperature_c")
        session = open_zenoh(locator)
        wait_for(lambda: status_of(session).get("temperature_c") == 5.0)
        took_s, _ = daemon.stop()
        assert took_s < STOP_S
        hear("STOPPING=1")


def test_a_disk_that_takes_no_more_costs_recordings_and_no_event(
    start_daemon, tmp_path, open_zenoh, free_locator
):
    locator = free_locator()
    daemon = start_daemon(
        "ping_rate_hz: 5\n"
        f"record: {{folder: '{tmp_path}/rec', before_s: 1, after_s: 30, keep_free_mb: 0}}\n",
        "connect: [], commands: true",
        locator,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000)),
    )
    session = open_zenoh(locator)
    wait_for(lambda: daemon.check() and status_of(session).get("events", 0) >= 3)
    (reply,) = session.get("ertis/t/cmd/record", timeout=5.0)
    path = json.loads(reply.ok.payload.to_bytes())["path"]
    wait_for(lambda: status_of(session).get("recordings_failed", 0) == 1)
    events = status_of(session)["events"]
    wait_for(lambda: status_of(session)["events"] > events + 3)
    assert status_of(session)["pings_failed"] == 0
    pings = 0
    with contextlib.suppress(Exception):  # how it is cut off is the recording's own business
        for _ in read_recording(path):
            pings += 1
    assert pings >= 3


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("detector: {model: MODEL}", r"ertis: .*rubbish\.safetensors"),
        ("device: {name: t, address: 'replay:RUBBISH'}", r"ertis: .*rubbish\.mcap"),
        (
            "device: {name: t, address: 'hal:9000'}",
            r"ertis: .*: address 'hal:9000' is of unknown kind",
        ),
        ("queue_size: [", r"ertis: .*ertis\.yaml:\d+:\d+: "),
    ],
)
def test_what_is_bad_ends_it_with_one_line(tmp_path, text, words):
    for name in ("rubbish.safetensors", "rubbish.mcap"):
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n" + b"rubbish" * 100)
    text = text.replace("MODEL", str(tmp_path / "rubbish.safetensors"))
    text = text.replace("RUBBISH", str(tmp_path / "rubbish.mcap"))
    path = tmp_path / "ertis.yaml"
    path.write_text(f"zenoh: {{connect: [], listen: []}}\n{text}\n")
    done = subprocess.run(
        [sys.executable, "-m", "ertis_daemon.cli", "run", "--config", str(path)],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 1
    said = [line for line in done.stderr.splitlines() if line.startswith("ertis: ")]
    assert len(said) == 1, done.stderr
    assert re.match(words, said[0]), done.stderr
    assert "Traceback" not in done.stderr
