"""Other commands of ours as processes, ended in order and in bounded time."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

GRACE_S = 3.0  # from SIGTERM to SIGKILL


def start(
    arguments: list[str], errors: Path, *, stdout: int | IO[bytes] | None = None
) -> subprocess.Popen[bytes]:
    """Start ``ertis ARGUMENTS`` in a session of its own, so that Ctrl-C does not reach it."""
    with errors.open("ab") as file:
        return subprocess.Popen(
            [sys.executable, "-m", "ertis_daemon.cli", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=file,
            start_new_session=True,
        )


def end(process: subprocess.Popen[bytes]) -> None:
    """SIGTERM, then SIGKILL to its whole session; returns when it is gone."""
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(GRACE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if process.stdout:
        process.stdout.close()
