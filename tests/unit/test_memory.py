"""The settings are the process's own, so they are tried in one of its own."""

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


LOADED = """
import gc
from ertis_daemon.memory import keep_what_is_loaded

loaded = [[] for _ in range(100_000)]
keep_what_is_loaded()
looked_at = len(gc.get_objects())
loop = []
loop.append(loop)
del loop
print(looked_at, gc.collect())
"""


def test_the_collector_leaves_what_is_loaded_alone_and_goes_on_with_the_rest():
    command = [sys.executable, "-c", LOADED]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    looked_at, collected = map(int, done.stdout.split())
    assert looked_at < 1000
    assert collected == 1
