"""The test's end of the incumbent client: its functions by name, and its log."""

import json
import select
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

PATIENCE_S = 60.0


class DrivenClient:
    """An unmodified rtisdev in a process of its own; its functions are called by name."""

    def __init__(self, platform, package_folder, work_folder):
        self.platform = platform
        self._log = Path(work_folder) / "log.txt"
        with self._log.open("wb") as log:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-I", str(Path(__file__).with_name("client.py"))),
                    *(platform, str(package_folder), str(work_folder)),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
            )

    @property
    def log(self):
        """All that it logged so far."""
        return self._log.read_text()

    def call(self, name, *args, **options):
        """Call a function of the package; words and samples come back as arrays."""
        self._process.stdin.write(json.dumps([name, args, options]).encode() + b"\n")
        self._process.stdin.flush()
        if not select.select([self._process.stdout], [], [], PATIENCE_S)[0]:
            raise AssertionError(f"{name} did not return in {PATIENCE_S:g} s: {self.log[-2000:]}")
        line = self._process.stdout.readline()
        answer = json.loads(line) if line else {"error": "it died"}
        if "error" in answer:
            raise AssertionError(f"{name}: {answer['error']}\n{self.log[-2000:]}")
        value = answer["value"]
        if isinstance(value, dict):
            for key in [key for key in value if key.endswith("_file")]:
                path = value.pop(key)
                value[key.removesuffix("_file")] = None if path is None else np.load(path)
        return value

    def listen(self, config_name):
        """Start its process for externally triggered pings; return when that waits for bytes."""
        pid = self.call("listen", config_name)
        deadline = time.monotonic() + PATIENCE_S
        before = None
        while (now := _sleeping(pid)) is None or now != before or "Starting the" not in self.log:
            assert time.monotonic() < deadline, self.log[-2000:]
            before = now
            time.sleep(0.1)

    def close(self):
        """End it."""
        self._process.stdin.close()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def _sleeping(pid):
    """How often a process has gone to sleep, if it is asleep."""
    fields = dict(
        line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    return fields["voluntary_ctxt_switches"] if fields["State"].split()[0] == "S" else None
