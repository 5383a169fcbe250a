"""SIGKILL at any moment of a recording: what was written is there, whole."""

import subprocess
import sys
import time

import numpy as np
import pytest
from recorder import words_of

from ertis_driver.errors import RecordingError
from ertis_driver.recording import open_recording
from ertis_driver.recover import recover

RECORDER = "tests/rigs/recorder.py"
MAX_DELAY_S = 0.08  # a few dozen pings


def pings_of(path):
    """Indices of the whole pings, each compared with what was written; and how the file ends."""
    indices = []
    try:
        for ping in open_recording(path):
            np.testing.assert_array_equal(ping.frame.words, words_of(ping.frame.ping_index))
            indices.append(ping.frame.ping_index)
    except RecordingError as error:
        return indices, str(error)
    return indices, ""


def kill_one(folder, root, seed):
    """Record, kill, and look: how many were said to be written, and how many are there."""
    rng = np.random.default_rng(seed)
    path = folder / f"{seed}.mcap"
    kind = "compressed" if seed % 3 == 0 else "plain"
    process = subprocess.Popen(
        [sys.executable, root / RECORDER, path, kind], stdout=subprocess.PIPE, text=True
    )
    with process:
        first = process.stdout.readline()
        time.sleep(rng.uniform(0, MAX_DELAY_S))
        process.kill()
        said = [first, *process.stdout.readlines()]
    # A line that the kill cut in two says nothing.
    written = max(int(line) for line in said if line.endswith("\n"))
    indices, error = pings_of(path)
    assert indices == list(range(len(indices))), seed
    assert len(indices) in (written, written + 1), seed
    assert "cut off" in error, seed
    recovery = recover(path, folder / f"{seed}.saved.mcap")
    assert recovery.num_pings == len(indices), seed
    assert recovery.pings_lost <= 1, seed
    assert pings_of(folder / f"{seed}.saved.mcap") == (indices, ""), seed
    path.unlink()
    (folder / f"{seed}.saved.mcap").unlink()


def test_a_killed_recorder_loses_no_ping_that_it_had_written(tmp_path, pytestconfig):
    for seed in range(4):
        kill_one(tmp_path, pytestconfig.rootpath, seed)


@pytest.mark.slow
def test_sixty_killed_recorders_lose_no_ping_that_they_had_written(tmp_path, pytestconfig):
    for seed in range(100, 160):
        kill_one(tmp_path, pytestconfig.rootpath, seed)
