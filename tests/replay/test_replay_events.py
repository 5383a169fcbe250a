"""A recording gives the same events, byte for byte, every time it is replayed."""

import dataclasses
import json
from pathlib import Path

import pytest

import ertis_simulator
from ertis_daemon.cli import main
from ertis_daemon.config import Config
from ertis_daemon.config_read import parse_config
from ertis_daemon.pipeline import build_pipeline
from ertis_daemon.service import Service
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.frame import AUDIO_RATE_HZ, PdmFrame
from ertis_driver.open import open_device
from ertis_driver.recording import RecordingInfo, RecordingWriter, open_recording
from ertis_simulator.scene_file import load_scene

NUM_WORDS = 163_840
# Each landmark at once, not when a tracker is sure of it.
EAGER = "tracker: {max_false_events_per_hour: 3600}\n"
DEMO = Path(ertis_simulator.__file__).parent / "scenes/demo.yaml"


class Listing:
    """Keeps what is published."""

    def __init__(self):
        self.events = []

    def publish(self, event):
        self.events.append(event.to_json())

    def publish_status(self, status):
        pass

    def publish_raw(self, frame):
        pass


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """The same two pings, plain and compressed."""
    folder = tmp_path_factory.mktemp("replayed")
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    scene = load_scene(DEMO)
    words = [scene.hear(index, NUM_WORDS, chirp) for index in range(2)]
    paths = folder / "plain.mcap", folder / "compressed.mcap"
    for path in paths:
        info = RecordingInfo("live", DEFAULT_CHIRP, NUM_WORDS)
        with RecordingWriter(path, info, compress=path.stem == "compressed") as writer:
            for index, heard in enumerate(words):
                writer.write(PdmFrame(heard, index, 10**18 + index * 50_000_000))
    return paths


def events_of(address):
    config = parse_config(EAGER.encode())
    sonar, listing = open_device(address), Listing()
    sonar.configure(config.settings())
    pipeline = build_pipeline(config, sonar.settings)
    Service(sonar, pipeline, listing, dataclasses.replace(config, queue_size=1)).run()
    return listing.events


def test_every_replay_gives_the_same_events(recordings):
    plain, compressed = recordings
    first = events_of(f"replay:{plain}")
    assert len(first) == 2, "there is something to compare"
    assert all(b'"source":"replay"' in event for event in first)
    assert events_of(f"replay:{plain}") == first
    assert events_of(f"replay:{plain}?rate=1") == first
    assert events_of(f"replay:{compressed}?rate=7") == first


def test_a_round_of_a_loop_differs_in_nothing_but_time_and_history(recordings):
    frames = [ping.frame for ping in open_recording(recordings[0])]
    with open_device(f"replay:{recordings[0]}?loop=1") as sonar:
        sonar.configure(Config().settings())
        for _ in range(2):
            for frame in frames:
                again = sonar.ping()
                assert (again.words == frame.words).all()
                assert again.ping_index == frame.ping_index


def test_the_command_publishes_what_the_recording_holds(recordings, tmp_path, capsys):
    (tmp_path / "e.yaml").write_text("zenoh: {connect: [], listen: [tcp/localhost:0]}\n" + EAGER)
    argv = ["replay", str(recordings[1]), "--rate", "0", "--config", str(tmp_path / "e.yaml")]
    assert main([*argv, "--json"]) == 0
    counters = json.loads(capsys.readouterr().out)
    assert (counters["pings_heard"], counters["events"], counters["queue_drops"]) == (2, 2, 0)
