"""The setting is the process's own, so it is tried in one of its own."""

import subprocess
import sys

PROGRAM = """
import resource
import sys
import numpy as np
from ertis_daemon.memory import keep_freed_memory

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

def work():
    parts = [np.ones(500_000 + 1000 * i, np.float32) for i in range(4)]
    del parts

if "keep" in sys.argv:
    assert keep_freed_memory()
for _ in range(3):
    work()
before = faults()
for _ in range(10):
    work()
print(faults() - before)
"""


def faults(*args):
    command = [sys.executable, "-c", PROGRAM, *args]
    return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def test_memory_that_is_freed_and_taken_again_costs_no_page_faults():
    assert faults() > 1000, "nothing to gain here"
    assert faults("keep") < 100
