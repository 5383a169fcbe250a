"""A job of its own: ``make install`` on a clean tree, as on a robot; the service; uninstalled."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

RESULTS = Path("/dev/ttyS1")
UNIT = "ertis-daemon.service"
PLACES = ("/opt", "/usr/local/bin", "/var/lib", "/etc")  # where something might be left
PATIENCE_S = 3600


def main(tree: str, wheels: str, python: str) -> None:
    """Install, look, start, look, uninstall, look; results go out as JSON."""
    environment = os.environ | {
        # As the documented way for a robot without a network: wheels instead of an index.
        "PIP_NO_INDEX": "1",
        "PIP_FIND_LINKS": wheels,
        "PIP_CONFIG_FILE": os.devnull,
        "PIP_NO_COMPILE": "1",
    }
    before = _entries()
    with RESULTS.open("w") as out:

        def tell(name: str, result: dict) -> None:
            for key, value in result.items():
                print(f"   {name} {key}: {value}", flush=True)
            out.write(json.dumps({name: result}) + "\n")
            out.flush()

        tell("install", _run("make", "install", f"PYTHON={python}", cwd=tree, env=environment))
        tell("appeared", {"entries": sorted(_entries() - before), "bytes": _size("/opt/ertis")})
        tell("verify", _run("systemd-analyze", "verify", f"/etc/systemd/system/{UNIT}"))
        tell("command", _run("/usr/local/bin/ertis", "--version"))
        tell("start", _run("systemctl", "start", UNIT))
        tell("status", _run("systemctl", "status", "--no-pager", UNIT))
        tell("uninstall", _run("make", "uninstall", f"PYTHON={python}", cwd=tree, env=environment))
        tell("left", {"entries": sorted(_entries() - before)})
        tell("gone", _run("systemctl", "status", "--no-pager", UNIT))


def _entries() -> set[str]:
    """All of /etc, and what stands in the other places."""
    found = {str(path) for place in PLACES for path in Path(place).iterdir()}
    return found | {str(Path(*one)) for one in _walk("/etc")}


def _walk(top: str) -> list[tuple[str, str]]:
    return [(at, name) for at, folders, files in os.walk(top) for name in (*folders, *files)]


def _size(top: str) -> int:
    return sum(Path(at, name).lstat().st_size for at, name in _walk(top))


def _run(*command: str, **options: object) -> dict:
    print("==", *command, flush=True)
    started_s = time.monotonic()
    done = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        **options,
    )
    seconds = round(time.monotonic() - started_s, 1)
    return {"code": done.returncode, "seconds": seconds, "said": done.stdout.strip()}


if __name__ == "__main__":
    main(*sys.argv[1:])
