"""``ertis demo``: emulator, daemon and monitor as three processes on a simulated scene."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from ertis_daemon.cli import processes
from ertis_daemon.cli.signals import StopFlag, stop_on_signals

START_S = 120.0  # the simulator is compiled on its first run, which a small board takes long for
SETTLE_S = 1.0  # the last event: recovered after 0.5 s, should it be lost
POLL_S = 0.1
PING_RATE_HZ = 5.0  # leaves the simulator and two cores time for the rest
# A demo of seconds shows what is likely; a robot waits until it is sure.
FALSE_EVENTS_PER_HOUR = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="N", help="from the first ping, default 20"
    )
    parser.add_argument(
        "--json", action="store_true", help="print events and the result, JSON Lines"
    )


def run(args: argparse.Namespace) -> int:
    """Show events for some seconds, then say how many were right."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="ertis-demo-")))
        flag = stack.enter_context(stop_on_signals(patient=True))
        demo = Demo(folder, flag, as_json=args.json)
        try:
            demo.play(args.seconds)
        except DemoError as error:
            if flag.event.is_set():
                return 130 if flag.interrupted else 0
            demo.show_errors()
            print(f"ertis: demo: {error}", file=sys.stderr)
            return 1
        finally:
            demo.end()
        if flag.event.is_set():
            return 130 if flag.interrupted else 0
        print(demo.result(), flush=True)
    return 0


class DemoError(Exception):
    """A process of the demo did not do its part; its messages say why."""


class Demo:
    """Three processes and what they leave in one folder."""

    def __init__(self, folder: Path, flag: StopFlag, *, as_json: bool) -> None:
        self._as_json = as_json
        self._folder = folder
        self._flag = flag
        self._truth = folder / "truth.jsonl"
        self._events = folder / "events.jsonl"
        self._counters = folder / "counters.json"
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._stack = ExitStack()

    def play(self, seconds: float) -> None:
        """Start all three, wait until the time is over, end the daemon.

        Raises
        ------
        DemoError
            If one of them ends or does not start.
        """
        print("ertis: simulated scene, everything below is simulated", file=sys.stderr)
        port = self._start_emulator()
        locator = f"tcp/127.0.0.1:{_free_port()}"
        self._start_daemon(port, locator)
        self._wait(START_S, until=lambda: _filled(self._truth), what="no ping was made")
        self._wait(seconds)
        self._stop("daemon")
        self._wait(SETTLE_S)
        self._stop("monitor")

    def _start_emulator(self) -> str:
        from importlib import resources

        scene = resources.as_file(resources.files("ertis_simulator") / "scenes" / "demo.yaml")
        path = self._stack.enter_context(scene)
        out = self._folder / "port"
        with out.open("wb") as file:
            self._run(
                "emulator", ["emulate", "--scene", str(path), "--truth", str(self._truth)], file
            )
        self._wait(START_S, until=lambda: out.read_bytes().endswith(b"\n"), what="no port")
        return out.read_text().splitlines()[0]

    def _start_daemon(self, port: str, locator: str) -> None:
        import dataclasses

        from ertis_daemon.config import (
            Config,
            DeviceConfig,
            TrackerConfig,
            ZenohConfig,
            example_yaml,
        )

        config = Config(
            device=DeviceConfig(name="demo", address=f"serial:{port}"),
            tracker=TrackerConfig(max_false_events_per_hour=FALSE_EVENTS_PER_HOUR),
            zenoh=ZenohConfig(connect=(), listen=(locator,)),
        )
        config = dataclasses.replace(config, ping_rate_hz=PING_RATE_HZ)
        path = self._folder / "ertis.yaml"
        path.write_text(example_yaml(config))
        # The monitor goes first and keeps trying, so that no event is missed.
        form = "--json" if self._as_json else "--lines"
        arguments = ["monitor", form, "--connect", locator, "--log", str(self._events)]
        self._run("monitor", arguments, None)
        with self._counters.open("wb") as file:
            self._run("daemon", ["run", "--config", str(path), "--json"], file)

    def _run(self, name: str, arguments: list[str], stdout: IO[bytes] | None) -> None:
        errors = self._folder / f"{name}.log"
        self._running[name] = processes.start(arguments, errors, stdout=stdout)

    def _wait(
        self, seconds: float, *, until: Callable[[], bool] | None = None, what: str = ""
    ) -> None:
        deadline_s = time.monotonic() + seconds
        while time.monotonic() < deadline_s:
            if until and until():
                return
            for name, process in self._running.items():
                if process.poll() is not None:
                    raise DemoError(f"the {name} ended with exit code {process.returncode}")
            if self._flag.event.wait(POLL_S):
                raise DemoError("interrupted")
        if until is not None:
            raise DemoError(f"{what} within {seconds:g} s")

    def _stop(self, name: str) -> None:
        processes.end(self._running.pop(name))

    def end(self) -> None:
        """End what still runs: daemon, then monitor, then emulator."""
        for name in ("daemon", "monitor", "emulator"):
            if name in self._running:
                self._stop(name)
        self._stack.close()

    def show_errors(self) -> None:
        """Print what the processes said, to stderr."""
        for path in sorted(self._folder.glob("*.log")):
            for line in path.read_text(errors="replace").splitlines()[-20:]:
                print(f"{path.stem}: {line}", file=sys.stderr)

    def result(self) -> str:
        """Return the line that the demo ends with.

        Raises
        ------
        TruthError
            If a process left no or damaged results.
        """
        from ertis_daemon.events import dump_json
        from ertis_daemon.truth import TruthError, compare, read_jsonl, summary

        counters = read_jsonl(self._counters)
        if not counters:
            raise TruthError("the daemon left no counters")
        events = read_jsonl(self._events)
        landmarks = sum(len(event["landmarks"]) for event in events)
        score = compare(events, read_jsonl(self._truth))
        if self._as_json:
            told = {"source": "sim", "pings_heard": counters[-1]["pings_heard"]}
            return dump_json({**told, "events": len(events), "score": score}).decode()
        return (
            f"heard {counters[-1]['pings_heard']} simulated pings, {len(events)} events with "
            f"{landmarks} landmarks: {summary(score)}"
        )


def _filled(path: Path) -> bool:
    return path.exists() and path.stat().st_size > 0


def _free_port() -> int:
    """Return a port that was free a moment ago; if another process takes it, the daemon says so."""
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
