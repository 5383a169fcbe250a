"""Run one job in the guest, by hand: ``run.py`` for all cases, ``run.py CASE...`` for some,
``run.py FILE.py [ARGUMENT...]`` for a script of yours. Prints the guest's console.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from qemu.kernel import NoGuest
from qemu.machine import boot


def main(arguments: list[str]) -> int:
    """Boot, echo, report; 0 if the guest came to its end without an error."""
    if arguments and arguments[0].endswith(".py"):
        job = [str(Path(arguments[0]).resolve()), *arguments[1:]]
    else:
        job = ["-m", "qemu.inside.job", *arguments]
    try:
        run = boot(job, echo=sys.stdout)
    except NoGuest as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps(run.results, indent=2))
    failed = [name for name, result in run.results.items() if "error" in result]
    print(f"{run.seconds:.1f} s, {len(run.results)} cases, {len(failed)} with errors")
    if run.timed_out:
        print("the guest hung and was killed", file=sys.stderr)
    return int(run.timed_out or bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
