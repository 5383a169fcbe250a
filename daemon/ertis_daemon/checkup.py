"""What works on this machine, what is missing, and what to do: behind ``ertis doctor``."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path
from typing import Literal

from ertis_daemon.config import Config
from ertis_driver.discover import PluggedIn, plugged_in
from ertis_driver.errors import ErtisError

State = Literal["ok", "missing", "wrong"]

RULE_NAME = "70-ertis.rules"
RULE_FOLDERS = ("/etc/udev/rules.d", "/run/udev/rules.d", "/lib/udev/rules.d")
LEAST_PYTHON = (3, 10)
RECORDING_BYTES_S = 18e6  # what the sensor makes at full rate
LEAST_RECORDING_S = 600.0
ZENOH_WAIT_MS = 1500
EXTRAS = {  # extra -> (module, what for)
    "sim": ("numba", "simulated scenes"),
    "train": ("sklearn", "training models"),
    "plot": ("matplotlib", "pictures"),
}
_UNSYNCED = 5  # adjtimex's TIME_ERROR: no clock holds it
_TIMEX_BYTES = 512  # more than struct timex has on any of our machines


@dataclass(frozen=True, slots=True)
class Check:
    """One thing looked at.

    name : str
    state : str
        ``ok``; ``missing``: something that is not needed for all; ``wrong``: to be put right.
    said : str
        What was met.
    todo : str
        What to do; empty if nothing is to be done.
    """

    name: str
    state: State
    said: str
    todo: str = ""


def check_all(config: Config) -> list[Check]:
    """Look at everything, one after the other; takes some seconds at most."""
    devices = plugged_in()
    looks: tuple[Callable[[], Iterable[Check]], ...] = (
        lambda: [check_python()],
        lambda: [check_blas()],
        lambda: check_extras(),
        lambda: check_sonars(devices),
        lambda: [check_rule(tuple(map(Path, RULE_FOLDERS)))],
        lambda: [check_modem_manager(Path("/proc"))],
        lambda: [check_model(config)],
        lambda: [check_zenoh(config)],
        lambda: [check_disk(Path.cwd())],
        lambda: [check_clock()],
    )
    return [check for look in looks for check in look()]


def check_python() -> Check:
    """Whether this Python is new enough."""
    met = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < LEAST_PYTHON:
        return Check("python", "wrong", met, "install Python 3.10 or newer")
    return Check("python", "ok", f"{met} at {sys.executable}")


def check_blas() -> Check:
    """How many threads numpy's arithmetic starts: more than one costs more than it gives."""
    import numpy as np

    tasks = Path("/proc/self/task")
    before = len(list(tasks.iterdir()))
    square = np.ones((512, 512), np.float32)
    square @ square
    threads = len(list(tasks.iterdir())) - before + 1
    asked = os.environ.get("OPENBLAS_NUM_THREADS", "not set")
    said = f"numpy {np.__version__}, OPENBLAS_NUM_THREADS {asked}"
    if asked != "1" or threads > 1:
        return Check("blas", "wrong", said, "unset OPENBLAS_NUM_THREADS: ertis sets it to 1")
    return Check("blas", "ok", said)


def check_extras() -> list[Check]:
    """Which optional parts are installed."""
    found = []
    for extra, (module, what_for) in EXTRAS.items():
        if util.find_spec(module) is None:
            todo = f"pip install 'ertis[{extra}]'"
            found.append(Check(f"extra {extra}", "missing", f"no {module}: {what_for}", todo))
        else:
            name = {"sklearn": "scikit-learn"}.get(module, module)
            said = f"{name} {metadata.version(name)}: {what_for}"
            found.append(Check(f"extra {extra}", "ok", said))
    return found


def check_sonars(devices: list[PluggedIn]) -> list[Check]:
    """Which sonars are plugged in, and whether they may be used."""
    sonars = [device for device in devices if not device.why_not()]
    if not sonars:
        todo = "check cable and power; `ertis devices --all` lists other ports"
        return [Check("sonar", "missing", "none is plugged in", todo)]
    found = []
    for device in sonars:
        if not device.may_open:
            todo = "sudo make udev, replug it; or join the group dialout and log in again"
            found.append(Check("sonar", "wrong", f"{device}: no permission", todo))
        elif device.holders:
            who = ", ".join(f"{one.pid} ({one.command})" for one in device.holders)
            todo = "end it, unless it is your daemon"
            found.append(Check("sonar", "missing", f"{device}: held by {who}", todo))
        else:
            found.append(Check("sonar", "ok", f"{device}: free"))
    return found


def check_rule(folders: tuple[Path, ...]) -> Check:
    """Whether udev knows the sonar."""
    for folder in folders:
        if (folder / RULE_NAME).exists():
            return Check("udev rule", "ok", str(folder / RULE_NAME))
    todo = "sudo make udev: opens the port to dialout, and keeps ModemManager off it"
    return Check("udev rule", "missing", f"no {RULE_NAME} in {folders[0]}", todo)


def check_modem_manager(proc: Path) -> Check:
    """Whether something that writes to new serial ports is running."""
    for path in proc.glob("[0-9]*/comm"):
        try:
            name = path.read_text().strip()
        except OSError:  # it has ended
            continue
        if name == "ModemManager":
            todo = f"the udev rule ({RULE_NAME}) keeps it off the sonar: sudo make udev"
            return Check("ModemManager", "missing", f"running, process {path.parent.name}", todo)
    return Check("ModemManager", "ok", "not running")


def check_model(config: Config) -> Check:
    """Whether the model fits what the sonar would be set to."""
    from ertis_daemon.pipeline import build_pipeline
    from ertis_detector.errors import DetectorError

    try:
        settings = config.settings()
        pipeline = build_pipeline(config, settings)
    except (DetectorError, ErtisError) as error:
        return Check("model", "wrong", str(error), "name another model or chirp")
    classes = " ".join(pipeline.classes)
    return Check("model", "ok", f"{pipeline.model_name} fits {settings.chirp.name}: {classes}")


def check_zenoh(config: Config) -> Check:
    """Whether a router answers at the configured places."""
    import zenoh

    from ertis_daemon.zenoh_session import PublisherError, close_session, session_config

    zenoh.init_log_from_env_or("off")
    places = ", ".join(config.zenoh.connect) or "nowhere"
    todo = "start one (zenohd, rmw_zenohd); without one, peers must listen for each other"
    try:
        client = session_config("client", config.zenoh.connect, ())
        client.insert_json5("connect/timeout_ms", str(ZENOH_WAIT_MS))
        session = zenoh.open(client)
    except (PublisherError, zenoh.ZError):
        said = f"zenoh {metadata.version('eclipse-zenoh')}, no router at {places}"
        return Check("zenoh", "missing", said, todo)
    routers = [str(one) for one in session.info.routers_zid()]
    close_session(session)
    return Check("zenoh", "ok", f"router {', '.join(routers) or 'found'} at {places}")


def check_disk(folder: Path) -> Check:
    """How long a recording into the present folder may be."""
    free = shutil.disk_usage(folder).free
    seconds = free / RECORDING_BYTES_S
    said = f"{free / 1e9:.1f} GB free in {folder}: {seconds / 3600:.1f} h of recording"
    if seconds < LEAST_RECORDING_S:
        return Check("disk", "wrong", said, "free some, or record elsewhere")
    return Check("disk", "ok", said)


def check_clock() -> Check:
    """Whether the kernel's clock is held by another: time stamps are of little use otherwise."""
    # struct timex begins with modes, which 0 leaves to be read only; man 2 adjtimex.
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    if state == -1:
        return Check("clock", "missing", f"cannot be asked: {os.strerror(ctypes.get_errno())}")
    if state == _UNSYNCED:
        todo = "start chrony or systemd-timesyncd: event times follow this clock"
        return Check("clock", "missing", "not synchronised", todo)
    return Check("clock", "ok", "synchronised")
