"""The daemon as a whole: real Zenoh, firmware emulators behind ptys, the shipped model."""

import itertools
import json
import threading
import time
import urllib.request
from functools import partial

import jsonschema
import numpy as np
import patience
import pytest
import zenoh
from daemon_rig import EAGER

from ertis_daemon.config_read import parse_config
from ertis_daemon.layers import Sources
from ertis_daemon.pipeline import build_pipeline
from ertis_daemon.serving.daemon import Daemon
from ertis_detector.errors import DetectorError
from ertis_detector.model import shipped_model
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.emulator import Emulator
from ertis_driver.fault_plan import NamedFaults, parse_fault
from ertis_driver.frame import PdmFrame
from ertis_driver.protocol import decode_frame
from ertis_driver.recording import RecordingWriter, read_recording

NUM_WORDS = 65_536  # the fewest that the chirp can be looked for in
DEADLINE_S = 30.0
wait_for = partial(patience.wait_for, deadline_s=DEADLINE_S)


class Source:
    """Noise, and when each frame was asked for."""

    def __init__(self):
        self.times_s = []

    def next_frame(self, request):
        self.times_s.append(time.monotonic())
        rng = np.random.default_rng(request.index)
        return rng.integers(0, 2**32, request.num_words, dtype=np.uint32)


class Cable:
    """The link that udev makes, to whatever is plugged in."""

    def __init__(self, path):
        self.path = path
        self.source = Source()
        self.emulator = None

    def plug(self, **options):
        self.emulator = Emulator(self.source, link=self.path, **options)
        self.emulator.start()
        return self

    def unplug(self):
        if self.emulator is not None:
            self.emulator.close()
            self.emulator = None


@pytest.fixture
def cables(tmp_path):
    made = {}

    def cable(name):
        return made.setdefault(name, Cable(tmp_path / f"port-{name}"))

    yield cable
    for one in made.values():
        one.unplug()


class Running:
    """A daemon in a thread, and a reader that shares no code with it."""

    def __init__(self, text, locator, folder):
        self.file = folder / "ertis.yaml"
        self.text = f"num_words: {NUM_WORDS}\n"
        self.zenoh = f"connect: [], listen: ['{locator}'], commands: true, raw: true"
        self.configure(text)
        sources = Sources(self.file, system_file=folder / "none", environment={})
        self.stop = threading.Event()
        self.daemon = Daemon(sources.load(), self.stop, sources)
        self.error = None
        self.thread = threading.Thread(target=self._run)
        self.thread.start()
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([locator]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = self._open(config)

    def configure(self, text):
        self.file.write_text(f"{self.text}zenoh: {{{self.zenoh}}}\n{text}")

    def _run(self):
        try:
            self.daemon.run()
        except Exception as error:  # noqa: BLE001  # shown to the test
            self.error = error

    def _open(self, config):
        deadline = time.monotonic() + DEADLINE_S
        while True:
            try:
                return zenoh.open(config)
            except zenoh.ZError:
                assert time.monotonic() < deadline
                assert self.thread.is_alive(), self.error
                time.sleep(0.05)

    def ask(self, key, ok=True):
        replies = list(self.session.get(key, timeout=25.0))
        told = [reply.ok if ok else reply.err for reply in replies]
        assert all(told), [r.err and r.err.payload.to_bytes() for r in replies]
        return [json.loads(one.payload.to_bytes()) for one in told]

    def status(self, name):
        return next(iter(self.ask(f"ertis/{name}/status")), {})

    def wait(self, name, **wanted):
        def fits():
            assert self.thread.is_alive(), self.error
            status = self.status(name)
            return all(
                status.get(key, 0) >= value if isinstance(value, int) else status.get(key) == value
                for key, value in wanted.items()
            )

        wait_for(fits, told=lambda: str(self.status(name)))
        return self.status(name)

    def end(self):
        self.stop.set()
        self.session.close()
        self.thread.join(DEADLINE_S)
        assert not self.thread.is_alive()


@pytest.fixture
def run(tmp_path, free_locator):
    running = []

    def run(text):
        running.append(Running(text, free_locator(), tmp_path))
        return running[-1]

    yield run
    for one in running:
        one.end()


def two(cables, extra=""):
    return "".join(
        f"sonars: {{a: {{device: {{address: 'serial:{cables('a').path}'}}{extra}}},"
        f" b: {{device: {{address: 'serial:{cables('b').path}'}}{extra}}}}}\n"
    )


def test_one_sonar_that_dies_and_comes_back_does_not_disturb_the_other(run, cables):
    for name in "ab":
        cables(name).plug()
    daemon = run(two(cables, ", ping_rate_hz: 20"))
    daemon.wait("a", state="running", pings_heard=3)
    before = daemon.wait("b", state="running", pings_heard=3)
    cables("a").unplug()
    daemon.wait("a", state="away", pings_away=1)
    heard = daemon.wait("a", state="away")["pings_heard"]
    during = daemon.wait("b", pings_heard=before["pings_heard"] + 10)
    assert during["state"] == "running"
    assert during["pings_lost"] == during["pings_away"] == 0
    cables("a").plug()
    back_s = time.monotonic()
    daemon.wait("a", state="running", pings_heard=heard + 1)
    assert time.monotonic() - back_s < DEADLINE_S
    assert daemon.status("b")["starts"] == 1
    assert [str(r.ok.key_expr) for r in daemon.session.liveliness().get("ertis/*/alive")]


def test_a_device_that_is_missing_at_the_start_is_waited_for_with_the_model_at_hand(
    run, cables, tmp_path
):
    model = tmp_path / "mine.safetensors"
    model.write_bytes(shipped_model(DEFAULT_CHIRP.name).read_bytes())
    daemon = run(
        f"device: {{name: a, address: 'serial:{cables('a').path}'}}\n"
        f"detector: {{model: '{model}'}}\n"
    )
    status = daemon.wait("a", state="waiting")
    assert status["reason"].startswith("DeviceNotFound: no device at")
    (info,) = daemon.ask("ertis/a/info")
    assert "firmware" not in info
    model.unlink()  # it was read once, and for all
    cables("a").plug()
    daemon.wait("a", state="running", pings_heard=2)
    (info,) = daemon.ask("ertis/a/info")
    assert (info["firmware"], info["source"], info["transform"]) == ("2.3.4", "sim", None)


def test_what_is_wrong_with_one_sonar_ends_that_one_only_and_a_reload_heals_it(
    run, cables, tmp_path
):
    cables("a").plug()
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"\x89MCAP0\r\nrubbish")
    good = f"a: {{device: {{address: 'serial:{cables('a').path}'}}}}"
    daemon = run(f"sonars: {{{good}, b: {{device: {{address: 'replay:{bad}'}}}}}}\n")
    status = daemon.wait("b", state="failed")
    assert status["reason"].startswith("RecordingDamaged: ")
    daemon.wait("a", state="running", pings_heard=2)

    daemon.configure(f"sonars: {{{good}, b: {{queue_size: 0}}}}\n")
    (refused,) = daemon.ask("ertis/a/cmd/reload", ok=False)
    assert "queue_size: 0, expected 1 to 64" in refused["error"]
    daemon.configure(f"sonars: {{{good}}}\nrecord: {{folder: {bad}/a}}\n")
    (refused,) = daemon.ask("ertis/a/cmd/reload", ok=False)
    assert f"record.folder of sonar 'a': {bad} is no folder: name another" in refused["error"]
    starts = daemon.status("a")["starts"]

    cables("b").plug()
    daemon.configure(
        f"sonars: {{{good}, b: {{device: {{address: 'serial:{cables('b').path}'}}, "
        f"pose: {{parent_frame: base_link}}}}}}\nprometheus: {{listen: 'localhost:1'}}\n"
    )
    (reply,) = daemon.ask("ertis/b/cmd/reload")
    assert reply["said"] == [
        "b: opened again, for device.address, pose.parent_frame",
        "prometheus: changed, which needs a restart of the daemon",
    ]
    (reply,) = daemon.ask("ertis/b/cmd/reload")
    assert reply["said"] == ["prometheus: changed, which needs a restart of the daemon"]
    daemon.wait("b", state="running", pings_heard=2)
    assert daemon.ask("ertis/b/info")[0]["transform"]["child_frame_id"] == "b_sonar"
    assert daemon.status("a")["starts"] == starts

    daemon.configure(f"sonars: {{{good}}}\n")
    assert "b: removed" in daemon.ask("ertis/a/cmd/reload")[0]["said"]
    wait_for(lambda: daemon.ask("ertis/b/status") == [])


def test_a_reload_that_removes_the_last_sonar_alive_and_heals_the_other_ends_nothing(
    run, cables, tmp_path
):
    for name in "ab":
        cables(name).plug()
    daemon = run(
        f"sonars: {{a: {{device: {{address: 'replay:{tmp_path}/none.mcap'}}}},"
        f" b: {{device: {{address: 'serial:{cables('b').path}'}}}}}}\n"
    )
    daemon.wait("a", state="failed")
    daemon.configure(f"sonars: {{a: {{device: {{address: 'serial:{cables('a').path}'}}}}}}\n")
    (reply,) = daemon.ask("ertis/a/cmd/reload")
    assert reply["said"] == ["b: removed", "a: opened again, for device.address"]
    daemon.wait("a", state="running", pings_heard=2)


def test_sonars_that_take_turns_never_listen_at_the_same_time(run, cables):
    for name in "ab":
        cables(name).plug()
    daemon = run(two(cables, ", take_turns: room"))
    for name in "ab":
        daemon.wait(name, pings_heard=12)
    times_s = {name: cables(name).source.times_s[1:] for name in "ab"}
    pings = sorted((at, name) for name in "ab" for at in times_s[name])
    listening_s = NUM_WORDS / 4.5e6
    gaps = [later[0] - sooner[0] for sooner, later in itertools.pairwise(pings)]
    assert min(gaps) > listening_s
    both_ping_from_s = max(times[0] for times in times_s.values())
    names = [name for at, name in pings if at >= both_ping_from_s][:22]
    changes = sum(x != y for x, y in itertools.pairwise(names))
    assert changes > 15, "one after the other"


def test_pings_on_command_come_when_asked_for_and_not_before(run, cables):
    cables("a").plug()
    daemon = run(f"device: {{name: a, address: 'serial:{cables('a').path}'}}\nping_on: command\n")
    daemon.wait("a", state="running")
    time.sleep(0.3)
    assert daemon.status("a")["pings_heard"] == 0
    (reply,) = daemon.ask("ertis/a/cmd/ping?count=3")
    assert reply == {"waiting": 3}
    daemon.wait("a", pings_heard=3)
    time.sleep(0.3)
    assert daemon.status("a")["pings_heard"] == 3
    for key, words in [
        ("ping?count=0", "count '0', expected 1 to 100"),
        ("ping?count=x", "count 'x', expected 1 to 100"),
        ("ping?cuont=1", "unknown parameter 'cuont', expected count"),
        ("reload?x=1", "unknown parameter 'x', expected none"),
        ("record?before_s=1e9", "before_s '1e9', expected 0 to 2"),
    ]:
        (refused,) = daemon.ask(f"ertis/a/cmd/{key}", ok=False)
        assert words in refused["error"]


def test_an_external_trigger_pings_and_its_silence_is_no_fault(run, cables):
    cable = cables("a").plug()
    daemon = run(f"device: {{name: a, address: 'serial:{cable.path}'}}\nping_on: pin2\n")
    daemon.wait("a", state="running")
    time.sleep(0.5)
    cable.emulator.trigger(1)
    cable.emulator.trigger(2)
    status = daemon.wait("a", pings_heard=1)
    assert (status["timeouts"], status["pings_heard"]) == (0, 1)


def test_the_pings_before_a_command_are_recorded_as_the_device_sent_them(run, cables, tmp_path):
    cable = cables("a").plug()
    daemon = run(
        f"device: {{name: a, address: 'serial:{cable.path}'}}\nping_rate_hz: 20\n"
        f"record: {{folder: '{tmp_path}/rec', keep_free_mb: 0}}\n"
    )
    daemon.wait("a", pings_heard=6)
    (reply,) = daemon.ask("ertis/a/cmd/record?before_s=2;after_s=0.2")
    daemon.wait("a", recordings=1)
    recording = read_recording(reply["path"])
    pings = list(recording)
    assert len(pings) >= 6
    assert (recording.info.source, recording.info.firmware) == ("sim", "2.3.4")
    first = pings[0].frame
    rng = np.random.default_rng(first.ping_index)
    assert np.array_equal(first.words, rng.integers(0, 2**32, NUM_WORDS, dtype=np.uint32))


def test_a_raw_frame_is_what_the_device_sent_and_only_goes_to_who_listens(run, cables):
    cable = cables("a").plug()
    daemon = run(f"device: {{name: a, address: 'serial:{cable.path}'}}\nping_rate_hz: 20\n")
    daemon.wait("a", pings_heard=2)
    subscriber = daemon.session.declare_subscriber("ertis/a/raw", zenoh.handlers.RingChannel(4))
    sample = subscriber.recv()
    about = json.loads(sample.attachment.to_bytes())
    raw = decode_frame(sample.payload.to_bytes())
    assert about["ping_index"] == raw.index
    frame = PdmFrame(raw.words, **about)
    assert (frame.active, frame.pdm_rate_hz, frame.clock_step_ns) == (True, 4_500_000, 0)
    assert sample.priority == zenoh.Priority.BACKGROUND
    rng = np.random.default_rng(raw.index)
    assert np.array_equal(raw.words, rng.integers(0, 2**32, NUM_WORDS, dtype=np.uint32))
    subscriber.undeclare()


def test_dead_microphones_are_named_and_recorded(run, cables, tmp_path):
    class Deaf(Source):
        def next_frame(self, request):
            return super().next_frame(request) & ~np.uint32(1 << 5)

    cable = cables("a")
    cable.source = Deaf()
    cable.plug()
    daemon = run(
        f"device: {{name: a, address: 'serial:{cable.path}'}}\nping_rate_hz: 20\n"
        f"record: {{folder: '{tmp_path}/rec', on: [dead], after_s: 0.1, keep_free_mb: 0}}\n"
    )
    status = daemon.wait("a", recordings=1)
    assert status["microphones_faulty"] == {"5": "stuck"}
    (path,) = (tmp_path / "rec").iterdir()
    assert path.name.endswith("-dead.mcap")


def test_metrics_are_served_for_prometheus(run, cables):
    pytest.importorskip("prometheus_client")
    from ertis_daemon.serving.prometheus import serve_metrics

    cables("a").plug()
    daemon = run(f"device: {{name: a, address: 'serial:{cables('a').path}'}}\n")
    daemon.wait("a", pings_heard=2)
    with (
        serve_metrics("localhost:0", daemon.daemon.statuses) as (host, port),
        urllib.request.urlopen(f"http://{host}:{port}/metrics", timeout=10) as reply,
    ):
        text = reply.read().decode()
    heard = next(line for line in text.splitlines() if line.startswith("ertis_pings_heard_total"))
    assert heard.startswith('ertis_pings_heard_total{sonar="a"}')
    assert float(heard.split()[-1]) >= 2
    assert 'ertis_is_running{sonar="a"} 1.0' in text


@pytest.fixture
def twenty_pings(heard_landmarks, tmp_path):
    """How to replay twenty pings with landmarks, on command."""
    heard = read_recording(heard_landmarks)
    (ping,) = heard
    path = tmp_path / "sim.mcap"
    with RecordingWriter(path, heard.info) as writer:
        for index in range(20):
            writer.write(PdmFrame(ping.frame.words, index, 10**9 + index * 40_000_000))
    return f"device: {{name: a, address: 'replay:{path}'}}\nping_on: command\n{EAGER}\n"


def test_a_ros_network_that_is_gone_costs_neither_sonar_nor_the_plain_events(run, twenty_pings):
    daemon = run(f"{twenty_pings}ros2: {{enabled: true}}\n")
    subscriber = daemon.session.declare_subscriber(
        "ertis/a/landmarks", zenoh.handlers.FifoChannel(100)
    )
    daemon.wait("a", state="running")
    daemon.ask("ertis/a/cmd/ping?count=3")
    status = daemon.wait("a", events=3)
    assert (status["publish_failures"], status["outputs_failing"]) == (0, {})
    daemon.daemon._ros2.close()
    daemon.ask("ertis/a/cmd/ping?count=15")
    status = daemon.wait("a", events=18)
    assert (status["starts"], status["pings_failed"], status["state"]) == (1, 0, "running")
    assert status["publish_failures"] >= 15
    assert status["outputs_failing"]["ROS 2 events"]
    samples = [wait_for(subscriber.try_recv) for _ in range(18)]
    indices = [json.loads(sample.payload.to_bytes())["ping_index"] for sample in samples]
    assert indices == list(range(18))


def test_the_daemon_ends_when_all_its_recordings_have_and_every_event_fits_the_schema(
    run, twenty_pings
):
    daemon = run(twenty_pings)
    subscriber = daemon.session.declare_subscriber(
        "ertis/a/landmarks", zenoh.handlers.FifoChannel(100)
    )
    daemon.wait("a", state="running")  # the daemon's session answers sooner than its sonars do
    (schema,) = daemon.ask("ertis/a/schema")
    daemon.ask("ertis/a/cmd/ping?count=21")  # the last one finds the end
    daemon.thread.join(DEADLINE_S)
    assert not daemon.thread.is_alive()
    assert daemon.error is None
    samples = [wait_for(subscriber.try_recv) for _ in range(20)]  # the last may be under way still
    assert subscriber.try_recv() is None
    events = [json.loads(sample.payload.to_bytes()) for sample in samples]
    assert len(events) == 20
    for event in events:
        jsonschema.validate(event, schema)
    assert {event["source"] for event in events} == {"sim"}
    assert daemon.daemon.statuses()["a"].pings_heard == 20


@pytest.mark.slow  # half a minute: six times five seconds of silence before it is opened anew
def test_pings_from_before_a_sonar_was_opened_anew_count_towards_the_last_one(run, cables):
    silence = [parse_fault(f"silent@frame={index}") for index in range(3, 9)]
    cable = cables("a").plug(faults=NamedFaults(silence))
    daemon = run(f"device: {{name: a, address: 'serial:{cable.path}'}}\nmax_pings: 6\n")
    daemon.thread.join(3 * DEADLINE_S)
    assert not daemon.thread.is_alive()
    status = daemon.daemon.statuses()["a"]
    assert (status.pings_heard, status.starts, status.state) == (6, 2, "ended")


def test_a_silent_device_is_tried_again_until_it_speaks(run, cables, bare_pty):
    cable = cables("a")
    cable.path.symlink_to(bare_pty.path)
    daemon = run(f"device: {{name: a, address: 'serial:{cable.path}'}}\nping_rate_hz: 10\n")
    status = daemon.wait("a", state="failed")
    assert status["reason"].startswith("DeviceTimeout: ")
    cable.path.unlink()
    cable.plug()
    daemon.wait("a", state="running", pings_heard=2)
    assert daemon.status("a")["reason"] == ""


def test_tracks_are_not_lost_to_a_clock_that_is_set(heard_landmarks):
    config = parse_config(EAGER.encode())
    pipeline = build_pipeline(config, config.settings())
    (ping,) = read_recording(heard_landmarks)
    noise = np.random.default_rng(1).integers(0, 2**32, config.num_words, dtype=np.uint32)
    hour_ns = 3_600_000_000_000

    def process(index, words, time_ns, step_ns=0):
        return pipeline.process(PdmFrame(words, index, time_ns, clock_step_ns=step_ns)).tracks

    for index in range(10):
        tracks = process(index, ping.frame.words, 40_000_000 * index)
    assert tracks
    with pytest.raises(DetectorError, match="audio of shape"):  # it fails as the clock is set
        process(10, noise[:-7], 390_000_000 + hour_ns, 2 * hour_ns)
    assert process(10, noise, 400_000_000 + hour_ns, -hour_ns) == []
    after = process(11, ping.frame.words, 440_000_000 + hour_ns)
    assert {track.track_id for track in after} == {track.track_id for track in tracks}
