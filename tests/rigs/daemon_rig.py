"""``ertis run`` as a process, on an emulated sonar that hears landmarks; who listens shares no code
with it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from importlib import resources

import patience
import pytest
import zenoh

from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.emulator import Emulator
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_driver.replay_source import ReplaySource
from ertis_simulator.device import open_sim

DEADLINE_S = 40.0
wait_for = partial(patience.wait_for, deadline_s=DEADLINE_S)
EAGER = "tracker: {max_false_events_per_hour: 3600}"  # a landmark is announced by its first ping


@pytest.fixture(scope="session")
def heard_landmarks(tmp_path_factory):
    """A recording of one ping with landmarks, simulated."""
    path = tmp_path_factory.mktemp("heard") / "sim.mcap"
    settings = Settings()
    scene = resources.files("ertis_simulator") / "scenes" / "demo.yaml"
    info = RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=settings.num_words)
    with resources.as_file(scene) as file, open_sim(str(file)) as sonar:
        sonar.configure(settings)
        with RecordingWriter(path, info) as writer:
            writer.write(sonar.ping())
    return path


@pytest.fixture
def landmark_sonar(heard_landmarks, tmp_path):
    """That ping over and over, as a sonar on a pty."""
    with Emulator(ReplaySource(heard_landmarks), link=tmp_path / "port") as emulator:
        yield emulator


class Process:
    def __init__(self, arguments, folder, **options):
        self.log = folder / "stderr.txt"
        with self.log.open("ab") as errors:
            self.process = subprocess.Popen(
                [sys.executable, *arguments], stdout=subprocess.PIPE, stderr=errors, **options
            )

    def wait_for(self, text):
        """Wait until the log says it."""
        wait_for(
            lambda: self.check() and re.search(text, self.log.read_text()), told=self.log.read_text
        )

    def check(self):
        assert self.process.poll() is None, self.log.read_text()
        return True

    def stop(self, number=signal.SIGTERM):
        start_s = time.monotonic()
        self.process.send_signal(number)
        out, _ = self.process.communicate(timeout=DEADLINE_S)
        return time.monotonic() - start_s, out.decode()

    def end(self):
        if self.process.returncode is None:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


@pytest.fixture
def start_daemon(tmp_path, landmark_sonar):
    """Starts ``ertis run`` on the sonar; more configuration, and what Popen takes, may be given."""
    started = []

    def start(text="", zenoh_text="connect: []", locator=None, environment=None, **options):
        listen = f", listen: ['{locator}']" if locator else ", listen: []"
        path = tmp_path / "ertis.yaml"
        path.write_text(
            f"device: {{name: t, address: 'serial:{tmp_path / 'port'}'}}\n"
            f"zenoh: {{{zenoh_text}{listen}}}\n{EAGER}\n{text}"
        )
        env = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path), **(environment or {})}
        arguments = ["-m", "ertis_daemon.cli", "run", "--config", str(path), "--json"]
        started.append(Process(arguments, tmp_path, env=env, **options))
        return started[-1]

    yield start
    for one in started:
        one.end()


@pytest.fixture
def start_program(tmp_path):
    """Starts a Python program; returns it once it says that it is up."""
    started = []

    def helper(code, *arguments):
        started.append(Process(["-c", code, *arguments], tmp_path))
        assert started[-1].process.stdout.readline() == b"up\n"
        return started[-1]

    yield helper
    for one in started:
        one.end()


@pytest.fixture
def open_zenoh():
    sessions = []

    def open_client(locator):
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([locator]))
        config.insert_json5("connect/retry", '{"period_init_ms": 200, "period_max_ms": 500}')
        config.insert_json5("scouting/multicast/enabled", "false")
        config.insert_json5("timestamping/enabled", "true")
        deadline = time.monotonic() + DEADLINE_S
        while True:
            try:
                sessions.append(zenoh.open(config))
                return sessions[-1]
            except zenoh.ZError:
                assert time.monotonic() < deadline
                time.sleep(0.1)

    yield open_client
    for session in sessions:
        session.close()


def status_of(session):
    for reply in session.get("ertis/t/status", timeout=5.0):
        if reply.ok:
            return json.loads(reply.ok.payload.to_bytes())
    return {}
