"""What ``make run`` calls, as a person runs it: to its end, and with Ctrl-C at bad moments."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


def start_demo(folder, *arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "ertis_daemon.cli", "demo", *arguments],
        env={**os.environ, "TMPDIR": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def processes_of(folder):
    """Command lines that name the demo's own folder: its emulator and its daemon and monitor."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = path.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if str(folder) in line:
            found.append(line)
    return found


def test_the_demo_hears_landmarks_and_says_how_many_were_right(tmp_path):
    demo = start_demo(tmp_path, "--seconds", "6")
    out, errors = demo.communicate(timeout=200)
    assert demo.returncode == 0, errors
    lines = out.splitlines()
    assert any("  sim" in line and " track " in line for line in lines)
    assert lines[-1].startswith("heard ")
    assert "(all simulated)" in lines[-1]
    assert " 0 located" not in lines[-1]
    assert processes_of(tmp_path) == []


@pytest.mark.parametrize("after_s", [0.7, 4.0])
def test_ctrl_c_twice_at_once_leaves_no_process_and_no_traceback(tmp_path, after_s):
    demo = start_demo(tmp_path)
    time.sleep(after_s)
    assert processes_of(tmp_path)
    demo.send_signal(signal.SIGINT)
    time.sleep(0.02)
    demo.send_signal(signal.SIGINT)
    _, errors = demo.communicate(timeout=30)
    assert demo.returncode == 130
    assert "Traceback" not in errors
    assert processes_of(tmp_path) == []
