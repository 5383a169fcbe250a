"""Runs the incumbent client in a process of its own: a call a line in, what came of it a line out.

Started as ``python -I client.py linux|windows PACKAGE_FOLDER WORK_FOLDER``.
"""

import importlib
import json
import logging
import multiprocessing
import os
import queue
import sys
import types
from pathlib import Path

import numpy as np


class OtherOs(types.ModuleType):
    """The module ``os`` of a machine with another name."""

    name = "nt"

    def __getattr__(self, name):
        return getattr(os, name)


def load(platform, package_folder):
    """Import the package as it comes, and let it believe in the platform."""
    sys.path += [package_folder, str(Path(__file__).parent)]
    # What it imports on its way must see the true platform.
    for name in ("multiprocessing_logging", "scipy.io", "scipy.signal", "serial.tools.list_ports"):
        importlib.import_module(name)
    if platform == "windows":
        sys.modules["os"] = OtherOs("os")
    try:
        import rtisdev
    finally:
        sys.modules["os"] = os
    return rtisdev


class Calls:
    """What the test may ask for: any function of the package, and the externally triggered pings.

    Words go through files: they are too many for a line.
    """

    def __init__(self, package, work_folder):
        self.package = package
        self.work_folder = Path(work_folder)
        self.num_files = 0
        self.queue = multiprocessing.Queue()
        self.listener = None

    def __call__(self, name, args, options):
        own = {"listen": self.listen, "next_ping": self.next_ping, "unlisten": self.unlisten}
        return self.plain(own.get(name, getattr(self.package, name, None))(*args, **options))

    def listen(self, config_name):
        """Start the package's process for externally triggered pings; return its id."""
        self.listener = self.package.create_measure_external_trigger_queue(self.queue, config_name)
        self.listener.start()
        return self.listener.pid

    def next_ping(self, timeout_s):
        """Return the next ping, or None if none came."""
        try:
            return self.queue.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def unlisten(self):
        self.listener.terminate()
        self.listener.join()

    def plain(self, value):
        """What JSON can say of a result."""
        if isinstance(value, self.package.RTISMeasurement):
            return {
                "index": None if value.index is None else int(value.index),
                "active": bool(value.behaviour),
                "words_file": self.save(value.rawData),
            }
        if isinstance(value, self.package.RTISSettings):
            return {"chirp_file": self.save(value.dacSignal)}
        return value

    def save(self, array):
        if array is None:
            return None
        self.num_files += 1
        path = self.work_folder / f"{self.num_files}.npy"
        np.save(path, array)
        return str(path)


def main():
    platform, package_folder, work_folder = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever the package prints
    multiprocessing.set_start_method("fork")  # it counts on inherited globals
    call = Calls(load(platform, package_folder), work_folder)
    call.package.set_log_mode(3)
    for line in sys.stdin:
        name, args, options = json.loads(line)
        try:
            answer = {"value": call(name, args, options)}
        except Exception as error:
            logging.getLogger().exception("%s failed", name)
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers)


if __name__ == "__main__":
    main()
