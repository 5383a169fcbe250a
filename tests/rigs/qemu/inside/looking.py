"""What cases look at: ports that come and go, open files, processor time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")
POLL_S = 0.005


def wait_for(look: Callable[[], T], timeout_s: float = 10.0) -> T:
    """Return what ``look`` sees, once it sees something."""
    end_s = time.monotonic() + timeout_s
    while time.monotonic() < end_s:
        seen = look()
        if seen:
            return seen
        time.sleep(POLL_S)
    raise TimeoutError(f"nothing seen in {timeout_s} s")


def acm_ports() -> list[str]:
    """The host's serial ports, by name."""
    return sorted(str(path) for path in Path("/dev").glob("ttyACM*"))


def wait_for_port() -> str:
    """Wait until there is one."""
    return wait_for(acm_ports)[-1]


def wait_for_no_port() -> None:
    """Wait until there is none."""
    wait_for(lambda: not acm_ports())


def open_files(prefix: str) -> list[str]:
    """What this process holds open under a path, also if it is gone."""
    found = []
    for link in Path("/proc/self/fd").iterdir():
        try:
            target = str(link.readlink())
        except FileNotFoundError:  # the listing itself
            continue
        if target.startswith(prefix):
            found.append(target)
    return found
