"""The daemon for a long time: does it grow, and how late are its events?

``python tests/bench/soak.py --pings 100000`` pings as fast as it goes; ``--minutes 30 --rate 27.5``
at a set rate. Emulator, daemon and this reader are three processes. Prints a summary, writes one
sample a second to ``--out`` (JSON Lines), and draws them with ``--plot``. Ctrl-C ends it early and
tells so far. It never fails, as another machine, or a busy one, is no defect.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import zenoh
from soak_report import draw, summarize

NAME = "soak"
READY_S = 60.0
PAGE, TICK_HZ = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=0, help="end after so many")
    parser.add_argument("--minutes", type=float, default=0.0, help="end after so long")
    parser.add_argument("--rate", type=float, default=0.0, help="pings a second; 0: all it can")
    parser.add_argument("--num-words", type=int, default=163_840, help="of each frame")
    parser.add_argument("--recording", type=Path, help="what the sonar plays; else simulated")
    parser.add_argument("--out", type=Path, default=Path("out/soak.jsonl"))
    parser.add_argument("--plot", type=Path)
    args = parser.parse_args()
    if not (args.pings or args.minutes):
        args.pings = 3000
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, args.out.open("w") as out:
        soak = Soak(Path(folder), args)
        samples = soak.run(out)
    print(summarize(samples, soak.latencies_ms, soak.transits_ms, soak.ready_s))
    if args.plot:
        draw(samples, soak.latencies_ms, args.plot)


class Soak:
    """One run. ``latencies_ms``: trigger to reader; ``transits_ms``: publisher to reader."""

    def __init__(self, folder: Path, args: argparse.Namespace) -> None:
        self._folder, self._args = folder, args
        self.latencies_ms: list[float] = []
        self.transits_ms: list[float] = []
        self.ready_s = float("nan")

    def run(self, out) -> list[dict]:
        """Start all, read until it is over; returns the samples."""
        with ExitStack() as stack:
            port = self._start_emulator(stack)
            locator = f"tcp/127.0.0.1:{_free_port()}"
            daemon = self._start_daemon(stack, port, locator)
            config = zenoh.Config()
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", json.dumps([locator]))
            config.insert_json5("scouting/multicast/enabled", "false")
            session = stack.enter_context(zenoh.open(config))
            return self._read(session, daemon, out)

    def _start_emulator(self, stack: ExitStack) -> str:
        recording = self._args.recording or _simulate(self._folder / "sim.mcap")
        process = _start(stack, "emulate", "--replay", str(recording), stdout=subprocess.PIPE)
        return process.stdout.readline().decode().strip()

    def _start_daemon(self, stack: ExitStack, port: str, locator: str) -> subprocess.Popen:
        path = self._folder / "ertis.yaml"
        path.write_text(
            f"device: {{name: {NAME}, address: 'serial:{port}'}}\nping_rate_hz: {self._args.rate}\n"
            f"num_words: {self._args.num_words}\n"
            f"zenoh: {{connect: [], listen: ['{locator}']}}\n"
        )
        notify = self._folder / "notify"
        systemd = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        systemd.bind(os.fspath(notify))
        systemd.settimeout(READY_S)
        start_s = time.monotonic()
        environment = {**os.environ, "NOTIFY_SOCKET": os.fspath(notify)}
        daemon = _start(stack, "run", "--config", str(path), env=environment)
        while b"READY=1" not in systemd.recv(4096):
            pass
        self.ready_s = time.monotonic() - start_s
        return daemon

    def _read(self, session: zenoh.Session, daemon: subprocess.Popen, out) -> list[dict]:
        events = session.declare_subscriber(
            f"ertis/{NAME}/landmarks", zenoh.handlers.FifoChannel(1000)
        )
        samples: list[dict] = []
        with suppress(KeyboardInterrupt):
            self._sample(events, session, daemon, samples, out)
        return samples

    def _sample(self, events, session, daemon: subprocess.Popen, samples: list[dict], out) -> None:
        start_s = due_s = time.monotonic()
        while daemon.poll() is None:
            self._take(events)
            now_s = time.monotonic()
            if now_s < due_s:
                time.sleep(0.001)  # part of every latency that is measured here
                continue
            due_s = now_s + 1.0
            sample = {"t_s": now_s - start_s, **_usage(daemon.pid), **_status(session)}
            samples.append(sample)
            out.write(json.dumps(sample) + "\n")
            heard = sample.get("pings_heard", 0)
            if self._args.pings and heard >= self._args.pings:
                return
            if self._args.minutes and now_s - start_s > 60 * self._args.minutes:
                return

    def _take(self, events) -> None:
        while (sample := events.try_recv()) is not None:
            now_ns = time.time_ns()
            event = json.loads(sample.payload.to_bytes())
            self.latencies_ms.append((now_ns - event["ping_time_ns"]) / 1e6)
            sent = sample.timestamp.get_time()
            self.transits_ms.append(now_ns / 1e6 - 1e3 * sent.timestamp())


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


def _usage(pid: int) -> dict:
    """Memory, threads, descriptors and processor time of a process."""
    folder = Path(f"/proc/{pid}")
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    return {
        "rss_mb": int((folder / "statm").read_text().split()[1]) * PAGE / 1e6,
        "threads": int(fields[17]),
        "fds": len(list((folder / "fd").iterdir())),
        "cpu_s": (int(fields[11]) + int(fields[12])) / TICK_HZ,
    }


def _status(session: zenoh.Session) -> dict:
    for reply in session.get(f"ertis/{NAME}/status", timeout=5.0):
        if reply.ok:
            return json.loads(reply.ok.payload.to_bytes())
    return {}


def _simulate(path: Path) -> Path:
    from importlib import resources

    from ertis_driver.chirp import DEFAULT_CHIRP
    from ertis_driver.device import Settings
    from ertis_driver.recording import RecordingInfo, RecordingWriter
    from ertis_simulator.device import open_sim

    settings = Settings()
    scene = resources.files("ertis_simulator") / "scenes" / "demo.yaml"
    info = RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=settings.num_words)
    with resources.as_file(scene) as file, open_sim(str(file)) as sonar:
        sonar.configure(settings)
        with RecordingWriter(path, info) as writer:
            for _ in range(4):
                writer.write(sonar.ping())
    return path


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    np.set_printoptions(precision=3)
    main()
