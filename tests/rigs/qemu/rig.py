"""What the rigs that boot a guest share: what must be there, what was seen, and what it found."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from qemu.kernel import CHECKOUT, NoGuest
from qemu.machine import boot

PYTHON = "/usr/bin/python3"


def skip_without_systemd():
    if not Path("/lib/systemd/systemd").exists():
        pytest.skip("no systemd to boot the guest with: apt install systemd udev")
    if not Path(PYTHON).exists():
        pytest.skip(f"no {PYTHON}, which is the Python that a service may see")


def run_from_index(command, *, limit_s, unless, cwd=None):
    """Run what takes packages from the index; skip where that is late, or says ``unless``."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    try:
        done = subprocess.run(
            command,
            cwd=cwd,
            env=environment,
            capture_output=True,
            text=True,
            timeout=limit_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        pytest.skip(f"the package index did not deliver what is to be installed in {limit_s} s")
    if done.returncode and re.search(unless, done.stderr + done.stdout):
        pytest.skip(f"nothing to install from: {done.stderr.strip()[-300:]}")
    assert done.returncode == 0, done.stderr[-3000:]


def boot_or_skip(job, transcript="", **options):
    """One boot; what was seen is left in ``out/``, if it has a name."""
    try:
        run = boot(job, **options)
    except NoGuest as reason:
        pytest.skip(str(reason))
    if transcript:
        path = CHECKOUT / "out" / transcript
        path.parent.mkdir(exist_ok=True)
        path.write_text(run.console)
    return run


def found(guest, step):
    """What a step of the guest's job found, which must have come to its end."""
    end = f"{'killed' if guest.timed_out else 'off'} after {guest.seconds:.0f} s"
    assert step in guest.results, f"no end of {step}; guest {end}:\n{guest.console[-3000:]}"
    result = guest.results[step]
    assert "error" not in result, result["error"]
    return result
