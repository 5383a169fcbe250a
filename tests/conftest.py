import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from ertis_daemon.blas import settle_blas

settle_blas()  # as the command does: with more threads, sums are rounded otherwise in each process

# Nothing is timed: that a machine is busy is no defect.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

REQUIREMENTS = Path(__file__).with_name("rtisdev.txt")
TIMEOUT_S = 300


@pytest.fixture(scope="session")
def rtisdev_folder(request):
    """The incumbent client as the package index has it, by hash; kept in pytest's cache.

    Not ours to copy: its licence is CC BY-NC-SA.
    """
    kept = request.config.cache.mkdir("rtisdev-2.16.0") / "packages"
    if kept.exists():
        return kept
    part = kept.with_suffix(".part")
    command = [
        *(sys.executable, "-m", "pip", "install", "--no-deps", "--no-compile", "--upgrade"),
        *("--require-hashes", "--only-binary", ":all:"),
        *("--target", str(part), "-r", str(REQUIREMENTS)),
    ]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"the package index did not deliver rtisdev within {TIMEOUT_S} s")
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1:]
        pytest.skip(f"no package index, or no rtisdev 2.16.0 in it: {' '.join(last)}")
    return part.replace(kept)
