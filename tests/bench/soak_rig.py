"""What a soak run is made of: an emulated sonar, the daemon, a subscriber, each a process."""

from __future__ import annotations

import json
import os
import re
import resource
import socket
import subprocess
import sys
import time
from collections import deque
from contextlib import ExitStack
from importlib import resources
from pathlib import Path

import zenoh

from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.links import SerialLink
from ertis_driver.protocol import encode_frame_size, encode_trigger, frame_bytes
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.device import open_sim

NAME = "soak"
PATIENCE_S = 120.0  # a machine may be busy
FLOOR_PINGS = 100
PAGE, TICK_HZ = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
# What ``ertis run -v`` says of each event.
TOLD = re.compile(r"ping (\d+): \d+ landmarks, ([\d.]+) ms after its last byte")


class Emulated:
    """``ertis emulate`` on a pty."""

    def __init__(self, stack: ExitStack, recording: Path) -> None:
        self._process = _start(stack, "emulate", "--replay", str(recording), stdout=subprocess.PIPE)
        self.port = self._process.stdout.readline().decode().strip()

    def floor(self, num_words: int, rate_hz: float) -> dict[str, float]:
        """Processor time that nothing but reading the bytes takes, ms a ping."""
        size = frame_bytes(num_words)
        buffer = memoryview(bytearray(size))
        link = SerialLink(self.port)
        try:
            link.write(encode_frame_size(num_words), time.monotonic() + PATIENCE_S)
            _read_all(link, buffer[:4])
            os.set_blocking(link._fd, True)
            before = resource.getrusage(resource.RUSAGE_THREAD)
            for _ in range(FLOOR_PINGS):
                os.write(link._fd, encode_trigger(active=True))
                count = 0
                while count < size:
                    count += os.readv(link._fd, [buffer[count:]])
                time.sleep(1.0 / rate_hz if rate_hz else 0.0)
            after = resource.getrusage(resource.RUSAGE_THREAD)
        finally:
            link.close()
        return {
            "user_ms": 1e3 * (after.ru_utime - before.ru_utime) / FLOOR_PINGS,
            "system_ms": 1e3 * (after.ru_stime - before.ru_stime) / FLOOR_PINGS,
        }


class Daemon:
    """``ertis run`` on that port, with an event a ping.

    Attributes
    ----------
    ready_s : float
        From its start to READY.
    """

    def __init__(
        self, stack: ExitStack, folder: Path, port: str, rate_hz: float, num_words: int
    ) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.locator = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        path = folder / "ertis.yaml"
        path.write_text(
            f"device: {{name: {NAME}, address: 'serial:{port}'}}\nping_rate_hz: {rate_hz}\n"
            f"num_words: {num_words}\n"
            "tracker: {max_false_events_per_hour: 3600}\n"
            f"zenoh: {{connect: [], listen: ['{self.locator}']}}\n"
        )
        systemd = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        systemd.bind(os.fspath(folder / "notify"))
        systemd.settimeout(PATIENCE_S)
        environment = {**os.environ, "NOTIFY_SOCKET": os.fspath(folder / "notify")}
        self._log = folder / "daemon.log"
        log = stack.enter_context(self._log.open("wb"))
        start_s = time.monotonic()
        arguments = ("run", "-v", "--config", str(path))
        self._process = _start(stack, *arguments, env=environment, stderr=log)
        while b"READY=1" not in systemd.recv(4096):
            pass
        self.ready_s = time.monotonic() - start_s
        self._said = stack.enter_context(self._log.open())
        self._rest = ""

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def usage(self) -> dict[str, float]:
        """Memory, threads, descriptors and processor time, s."""
        folder = Path(f"/proc/{self._process.pid}")
        fields = (folder / "stat").read_text().rpartition(")")[2].split()
        return {
            "rss_mb": int((folder / "statm").read_text().split()[1]) * PAGE / 1e6,
            "threads": int(fields[17]),
            "fds": len(list((folder / "fd").iterdir())),
            "user_s": int(fields[11]) / TICK_HZ,
            "system_s": int(fields[12]) / TICK_HZ,
        }

    def take_latencies(self) -> dict[int, float]:
        """Last byte to publication of the events since this was last asked, ms, by ping."""
        whole, _, self._rest = (self._rest + self._said.read()).rpartition("\n")
        return {int(index): float(ms) for index, ms in TOLD.findall(whole)}

    def last_words(self) -> str:
        """The end of its log."""
        return "\n".join(self._log.read_text().splitlines()[-20:])


class Subscriber:
    """A reader of the events, called as each of them comes."""

    def __init__(self, stack: ExitStack, locator: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([locator]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = stack.enter_context(zenoh.open(config))
        self._came: deque[tuple[int, zenoh.Sample]] = deque()
        self._published_ms: dict[int, float] = {}
        subscriber = self._session.declare_subscriber(
            f"ertis/{NAME}/landmarks", lambda sample: self._came.append((time.time_ns(), sample))
        )
        stack.callback(subscriber.undeclare)
        self._events: dict[int, tuple[float, float]] = {}

    def status(self) -> dict:
        """What the daemon says of itself; nothing if it is too busy to."""
        for reply in self._session.get(f"ertis/{NAME}/status", timeout=5.0):
            if reply.ok:
                return json.loads(reply.ok.payload.to_bytes())
        return {}

    def take(self, latencies_ms: dict[int, float]) -> list[tuple[float, float, float]]:
        """Of each event since: last byte to publication, to reader, and trigger to reader, ms."""
        self._published_ms.update(latencies_ms)
        while self._came:
            came_ns, sample = self._came.popleft()
            event = json.loads(sample.payload.to_bytes())
            put_ns = 1e9 * sample.timestamp.get_time().timestamp()
            self._events[event["ping_index"]] = (
                (came_ns - put_ns) / 1e6,
                (came_ns - event["ping_time_ns"]) / 1e6,
            )
        both = sorted(self._events.keys() & self._published_ms.keys())
        told = []
        for index in both:
            published_ms, (transit_ms, trigger_ms) = (
                self._published_ms.pop(index),
                self._events.pop(index),
            )
            told.append((published_ms, published_ms + max(transit_ms, 0.0), trigger_ms))
        return told


def machine() -> dict[str, float]:
    """Processor time that all processes together have used, and that the host took away, s."""
    fields = [int(text) for text in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]]
    idle, stolen = fields[3] + fields[4], fields[7]
    return {"busy_s": (sum(fields[:7]) - idle) / TICK_HZ, "stolen_s": stolen / TICK_HZ}


def simulate(path: Path, num_words: int) -> Path:
    """Record four pings of the demo's scene."""
    settings = Settings(num_words=num_words)
    scene = resources.files("ertis_simulator") / "scenes" / "demo.yaml"
    info = RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=num_words)
    with resources.as_file(scene) as file, open_sim(str(file)) as sonar:
        sonar.configure(settings)
        with RecordingWriter(path, info) as writer:
            for _ in range(4):
                writer.write(sonar.ping())
    return path


def _start(stack: ExitStack, *arguments: str, **options) -> subprocess.Popen:
    process = subprocess.Popen([sys.executable, "-m", "ertis_daemon.cli", *arguments], **options)

    def end() -> None:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    stack.callback(end)
    return process


def _read_all(link: SerialLink, buffer: memoryview) -> None:
    count = 0
    while count < len(buffer):
        count += link.read_into(buffer[count:], time.monotonic() + PATIENCE_S)
