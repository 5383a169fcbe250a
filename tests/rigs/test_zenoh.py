"""Real Zenoh sessions on localhost; the readers here share no code with the publisher."""

import contextlib
import fcntl
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import termios
import threading
import time

import jsonschema
import numpy as np
import pytest
import zenoh
from patience import wait_for
from zenoh import ext

from ertis_daemon.config import Config, DeviceConfig, OdometryConfig, ZenohConfig
from ertis_daemon.events import LandmarkEvent, LandmarkReport
from ertis_daemon.odometry import Odometry
from ertis_daemon.pipeline import Heard
from ertis_daemon.publisher import ZenohPublisher
from ertis_daemon.service import Service
from ertis_daemon.zenoh_session import Network, PublisherError
from ertis_detector.detection import Detection
from ertis_driver.open import open_device

DEADLINE_S = 10.0


def event(index):
    report = LandmarkReport(
        track_id=1,
        state="update",
        label="r48",
        probabilities={"r48": 0.9, "none": 0.1},
        range_m=1.0,
        azimuth_rad=0.1,
        elevation_rad=0.0,
        covariance=((1e-4, 0, 0), (0, 1e-3, 0), (0, 0, float("nan"))),
        snr_db=20.0,
        radius_m=0.048,
    )
    return LandmarkEvent(
        schema="ertis.landmarks/1",
        device="t",
        ping_index=index,
        ping_time_ns=time.time_ns(),
        time_uncertainty_ns=0,
        frame_id="sonar",
        source="sim",
        model="m",
        landmarks=(report,),
        speed_of_sound_m_s=343.2,
        temperature_c=20.0,
    )


@pytest.fixture
def locator():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def network(locator):
    with Network(ZenohConfig(connect=(), listen=(locator,))) as network:
        yield network


@pytest.fixture
def publisher(network):
    info = {"version": "1", "model": "m"}
    effective = Config().to_json()
    with ZenohPublisher(network.session, "t", info=info, effective_config=effective) as publisher:
        yield publisher


@contextlib.contextmanager
def client(locator):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([locator]))
    config.insert_json5("scouting/multicast/enabled", "false")
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()


@pytest.fixture
def reader(publisher, locator):
    with client(locator) as session:
        yield session


def recovering(session, key, history=None):
    """A subscriber with a promise: what a burst makes Zenoh drop, it asks for again."""
    return ext.declare_advanced_subscriber(
        session,
        key,
        zenoh.handlers.FifoChannel(100),
        history=history,
        recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )


def drain(subscriber, count):
    got = []

    def enough():
        while (sample := subscriber.try_recv()) is not None:
            got.append(sample)
        return len(got) >= count

    wait_for(enough)
    return got


def hear_first(publisher, subscriber):
    """Publish until the subscriber is known; what it heard of that is taken out."""

    def heard():
        publisher.publish(event(2**31))
        time.sleep(0.05)
        return subscriber.try_recv()

    wait_for(heard)
    time.sleep(0.2)
    while subscriber.try_recv() is not None:
        pass


def ask(session, key):
    replies = [reply.ok for reply in session.get(key, timeout=3.0)]
    return [(str(r.key_expr), str(r.encoding), json.loads(r.payload.to_bytes())) for r in replies]


def test_a_command_that_takes_long_keeps_nobody_else_waiting(network, locator):
    begun, end = threading.Event(), threading.Event()

    def obey(name, parameters):
        begun.set()
        return {"ended_by_us": end.wait(DEADLINE_S)}

    about = {"info": {"version": "1"}, "effective_config": {}}
    with (
        ZenohPublisher(network.session, "t", obey=obey, **about),
        client(locator) as session,
    ):
        reload = session.get("ertis/t/cmd/reload", timeout=2 * DEADLINE_S)
        assert begun.wait(DEADLINE_S)
        ((_, _, info),) = ask(session, "ertis/t/info")
        end.set()
        assert [json.loads(reply.ok.payload.to_bytes()) for reply in reload] == [
            {"ended_by_us": True}
        ]
    assert info == {"version": "1"}


def test_a_plain_subscriber_gets_events_that_fit_the_served_schema(publisher, reader):
    subscriber = reader.declare_subscriber("ertis/t/landmarks", zenoh.handlers.FifoChannel(100))
    hear_first(publisher, subscriber)
    samples = []
    for index in range(20):  # a burst may be dropped: a plain subscriber has no promise
        publisher.publish(event(index))
        samples += drain(subscriber, 1)
    ((key, encoding, schema),) = ask(reader, "ertis/t/schema")
    assert (key, encoding) == ("ertis/t/schema", "application/schema+json")
    for index, sample in enumerate(samples):
        assert str(sample.encoding) == "application/json;ertis.landmarks/1"
        assert sample.priority == zenoh.Priority.INTERACTIVE_HIGH
        assert sample.congestion_control == zenoh.CongestionControl.DROP
        assert sample.express
        value = json.loads(sample.payload.to_bytes())
        jsonschema.validate(value, schema)
        assert value["ping_index"] == index
        assert value["landmarks"][0]["covariance"][2] == [0, 0, None]


def test_a_late_joiner_with_history_gets_the_last_32(publisher, reader):
    for index in range(40):
        publisher.publish(event(index))
    subscriber = recovering(
        reader, "ertis/*/landmarks", ext.HistoryConfig(detect_late_publishers=True)
    )
    samples = drain(subscriber, 32)
    indices = [json.loads(s.payload.to_bytes())["ping_index"] for s in samples]
    assert indices == list(range(8, 40))


def test_queries_are_answered_and_last_is_empty_before_the_first(publisher, reader):
    assert ask(reader, "ertis/t/last") == []
    publisher.publish(event(3))
    publisher.publish_status({"pings_heard": 4, "latency_median_ms": float("nan")})
    ((_, encoding, last),) = ask(reader, "ertis/t/last")
    assert (encoding, last["ping_index"]) == ("application/json;ertis.landmarks/1", 3)
    ((_, _, status),) = ask(reader, "ertis/t/status")
    assert status == {"pings_heard": 4, "latency_median_ms": None}
    ((_, _, info),) = ask(reader, "ertis/t/info")
    assert info["model"] == "m"
    ((_, _, config),) = ask(reader, "ertis/t/config")
    assert config["device"]["name"] == "ertis"


def test_the_alive_token_goes_with_the_publisher(publisher, reader):
    assert len([r for r in reader.liveliness().get("ertis/*/alive", timeout=3.0) if r.ok]) == 1
    start = time.monotonic()
    publisher.close()
    publisher.close()
    assert time.monotonic() - start < DEADLINE_S
    wait_for(lambda: not [r for r in reader.liveliness().get("ertis/*/alive", timeout=1.0) if r.ok])


def test_a_port_taken_and_bad_locators_are_one_line(publisher, locator):
    for config, words in [
        (ZenohConfig(connect=(), listen=(locator,)), "already in use"),
        (ZenohConfig(connect=("foo/bar",), listen=()), "foo"),
        (ZenohConfig(mode="client", connect=("tcp/127.0.0.1:1",)), "Unable to connect"),
        (ZenohConfig(mode="client", connect=()), "No peer"),
    ]:
        with pytest.raises(PublisherError, match=words) as caught:
            Network(config)
        assert "\n" not in str(caught.value)
        assert ".rs" not in str(caught.value)


def test_the_service_publishes_what_a_serial_sonar_hears(publisher, reader, emulator):
    class Track:
        track_id, state = 1, "new"
        detection = Detection("r48", {"r48": 1.0}, 1.0, 0.0, 0.0, ((0.0,) * 3,) * 3, 20.0)

    class Pipeline:
        model_name, classes = "fake", ("r48",)

        def process(self, frame):
            return Heard([Track()])

    subscriber = recovering(reader, "ertis/t/landmarks")
    hear_first(publisher, subscriber)
    config = Config(device=DeviceConfig(name="t"), num_words=32_768, max_pings=5)
    sonar = open_device(f"serial:{emulator.path}")
    sonar.configure(config.settings())
    status = Service(sonar, Pipeline(), publisher, config).run()
    events = [json.loads(s.payload.to_bytes()) for s in drain(subscriber, 5)]
    assert (status.pings_heard, status.events, status.pings_lost) == (5, 5, 0)
    assert [e["source"] for e in events] == ["sim"] * 5
    first = events[0]["ping_index"]
    assert [e["ping_index"] for e in events] == list(range(first, first + 5))


def test_odometry_comes_over_zenoh_and_the_last_poses_wait(network, publisher, reader):
    odometry = Odometry(OdometryConfig(key="robot/odometry"))
    odometry.listen(network.subscribe("robot/odometry", 8))
    poses = reader.declare_publisher("robot/odometry")
    wait_for(lambda: poses.matching_status.matching)
    poses.put(b"nonsense")
    for n in range(20):  # more than wait: the oldest are dropped, the nonsense among them
        pose = {"time_ns": n * 10**8, "x_m": 0.1 * n, "y_m": 0.0, "yaw_rad": 0.0}
        poses.put(json.dumps(pose))
    ask(reader, "ertis/t/config")  # what was put before a query is there before its answer
    assert odometry.at_ping(19 * 10**8).is_known
    assert odometry.at_ping(15 * 10**8).is_known
    assert odometry.at_ping(19 * 10**8).motion.step.x_m == pytest.approx(0.4)
    assert not odometry.at_ping(5 * 10**8).is_known


def test_a_key_that_is_none_is_one_line(network):
    with pytest.raises(PublisherError, match="//") as caught:
        network.subscribe("a//b", 8)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_the_emulate_command_names_its_port_first_and_answers_there(tmp_path, options):
    recording = tmp_path / "r.bin"
    recording.write_bytes(np.random.default_rng(1).bytes(4 * 32_768))
    command = [sys.executable, "-m", "ertis_daemon.cli", "emulate", "--replay", str(recording)]
    process = subprocess.Popen(
        [*command, *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        said = process.stdout.readline().strip()
        port = json.loads(said)["port"] if options else said
        with open_device(f"serial:{port}") as sonar:
            sonar.configure(Config(num_words=32_768).settings())
            assert sonar.ping().words.tobytes() == recording.read_bytes()
            assert sonar.info.source == "replay"
        process.terminate()
        assert process.wait(DEADLINE_S) == 0
    finally:
        process.kill()
        process.communicate()


def test_a_process_that_fails_while_publishing_exits_at_once():
    code = (
        "from ertis_daemon.publisher import ZenohPublisher\n"
        "from ertis_daemon.zenoh_session import Network\n"
        "from ertis_daemon.config import ZenohConfig\n"
        "c = ZenohConfig(connect=(), listen=('tcp/127.0.0.1:0',))\n"
        "with Network(c) as n, ZenohPublisher(n.session, 't', info={}, effective_config={}):\n"
        "    print('up', flush=True)\n"
        "    raise RuntimeError('boom')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=8, check=False
    )
    assert (done.returncode, done.stdout) == (1, "up\n")
    assert "RuntimeError: boom" in done.stderr


def start_monitor(locator, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "ertis_daemon.cli", "monitor", "--connect", locator, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_the_monitor_prints_and_logs_what_was_before_it_and_what_comes(
    publisher, locator, tmp_path
):
    for index in range(3):
        publisher.publish(event(index))
    log = tmp_path / "e.jsonl"
    monitor = start_monitor(locator, "--log", str(log), "--count", "4")
    try:
        wait_for(lambda: log.exists() and log.read_bytes().count(b"\n") == 3)
        publisher.publish(event(3))
        out, err = monitor.communicate(timeout=DEADLINE_S)
    finally:
        monitor.kill()
    assert (monitor.returncode, err) == (0, "")
    assert len(out.splitlines()) == 4
    assert "r48  90 %   1.000 m" in out
    logged = [json.loads(line)["ping_index"] for line in log.read_text().splitlines()]
    assert logged == [0, 1, 2, 3]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_a_signal_ends_the_monitor_at_once_and_in_silence(publisher, locator, number, code):
    publisher.publish(event(0))
    monitor = start_monitor(locator, "--json")
    try:
        assert json.loads(monitor.stdout.readline())["ping_index"] == 0
        start = time.monotonic()
        monitor.send_signal(number)
        monitor.wait(DEADLINE_S)
        assert time.monotonic() - start < 5.0  # 0.1 s as a rule
        assert monitor.returncode == code
        assert monitor.stderr.read() == ""
    finally:
        monitor.kill()
        monitor.communicate()


def test_on_a_terminal_the_monitor_is_a_live_table_and_leaves_it_as_it_was(publisher, locator):
    publisher.publish_status({"state": "running", "source": "sim", "ping_rate_hz": 27.5})
    master, slave = os.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    command = [sys.executable, "-m", "ertis_daemon.cli", "monitor", "--connect", locator]
    monitor = subprocess.Popen(command, stdout=slave, stderr=subprocess.PIPE)
    os.close(slave)
    os.set_blocking(master, False)
    seen = bytearray()

    def shows(text):
        with contextlib.suppress(BlockingIOError, OSError):
            seen.extend(os.read(master, 65_536))
        return text in seen

    try:
        wait_for(lambda: shows(b"t  running  sim  |  27.5 pings/s"))
        publisher.publish(event(0))
        wait_for(lambda: shows(b"r48  90 %   1.000 m"))
        assert seen.startswith(b"\x1b[?1049h")
        monitor.send_signal(signal.SIGINT)
        wait_for(lambda: shows(b"\x1b[?1049l"))
        assert monitor.wait(DEADLINE_S) == 130
        assert monitor.stderr.read() == b""
    finally:
        monitor.kill()
        monitor.communicate()
        os.close(master)


def test_a_monitor_that_nobody_talks_to_says_what_to_do(locator):
    monitor = start_monitor(locator, "--json")
    try:
        line = monitor.stderr.readline()
        assert line.startswith(f"ertis: nobody at {locator} yet; --connect wants a Zenoh router")
    finally:
        monitor.kill()
        monitor.communicate()
