"""Boots the guest for one job and brings back what it found out."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from qemu.kernel import CHECKOUT, HERE, get_kernel, make_initramfs, require_tools

# /dev/kvm may open and then hang a stock kernel; emulation is fast enough and runs everywhere.
QEMU = shlex.split("""qemu-system-x86_64 -accel tcg,thread=multi -M q35 -cpu max -smp 2
-nodefaults -no-user-config -nographic -no-reboot""")
COMMAND_LINE = (
    "console=ttyS0 panic=-1 quiet tsc=reliable nokaslr mitigations=off random.trust_cpu=on"
    " no_timer_check"  # a busy host is too slow for it, and the kernel would give up
)
BOOT_TIMEOUT_S = 280


@dataclass(frozen=True)
class GuestRun:
    """What came of one boot.

    results : dict
        By case: what it returned, or ``{"error": traceback}``.
    console : str
        All that the guest printed.
    """

    results: dict[str, Any]
    console: str
    seconds: float
    timed_out: bool


def boot(
    job: list[str],
    *,
    stage: Path | None = None,
    memory_mb: int = 1024,
    timeout_s: float = BOOT_TIMEOUT_S,
    echo: TextIO | None = None,
) -> GuestRun:
    """Run ``python job...`` in a fresh guest; kill it when it takes too long.

    With ``stage``, a folder laid over the root, under systemd.

    Raises
    ------
    NoGuest
        If it cannot be made here.
    """
    require_tools()
    kernel = get_kernel()
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        initramfs, results = Path(scratch, "initramfs"), Path(scratch, "results")
        init = HERE / ("init_systemd.sh" if stage else "init.sh")
        make_initramfs(kernel, init, job_script(job), initramfs)
        # The second serial port carries the results, so that no kernel message gets into them.
        files = ["-kernel", kernel.image, "-initrd", initramfs, "-append", COMMAND_LINE]
        ports = ["-serial", "stdio", "-serial", f"file:{results}"]
        shares = [*_share(Path("/"), "host"), *(_share(stage, "stage") if stage else ())]
        command = [*QEMU, "-m", str(memory_mb), *shares, *map(str, files), *ports]
        console, timed_out = _run_qemu(command, timeout_s, echo)
        found = read_results(results.read_text(errors="replace") if results.exists() else "")
    return GuestRun(found, console, time.monotonic() - started_s, timed_out)


def _share(folder: Path, tag: str) -> list[str]:
    path = str(folder).replace(",", ",,")
    options = f"mount_tag={tag},security_model=none,readonly=on,multidevs=remap"
    return ["-virtfs", f"local,path={path},{options}"]


def job_script(job: list[str]) -> str:
    """Shell script that runs the checkout's code with this Python, in the guest."""
    folders = [CHECKOUT, *(CHECKOUT / name for name in ("detector", "simulator", "daemon"))]
    path = os.pathsep.join(str(folder) for folder in [*folders, HERE.parent])
    settings = {
        "PYTHONPATH": path,
        "PYTHONDONTWRITEBYTECODE": "1",
        "PATH": f"{Path(sys.executable).parent}:/usr/sbin:/usr/bin:/sbin:/bin",
        "TMPDIR": "/dev/shm",
        "HOME": "/dev/shm",
        "LANG": "C.UTF-8",
        "OPENBLAS_NUM_THREADS": "1",
    }
    words = [f"{name}={value}" for name, value in settings.items()]
    command = ["env", "-i", *words, sys.executable, "-u", *job]
    return f"cd /dev/shm && exec {shlex.join(command)}\n"


def read_results(text: str) -> dict[str, Any]:
    """Read one JSON object a line; a line that a dying guest tore is left out."""
    results: dict[str, Any] = {}
    for line in text.splitlines():
        try:
            results |= json.loads(line)
        except ValueError:
            continue
    return results


def _run_qemu(command: list[str], timeout_s: float, echo: TextIO | None) -> tuple[str, bool]:
    lines: list[str] = []
    with subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        reader = threading.Thread(target=_copy_lines, args=(process, lines, echo))
        reader.start()
        timed_out = False
        try:
            process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            timed_out = True
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            reader.join()
    return "".join(lines), timed_out


def _copy_lines(process: subprocess.Popen[str], lines: list[str], echo: TextIO | None) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.append(line.rstrip() + "\n")
        if echo is not None:
            echo.write(lines[-1])
            echo.flush()
