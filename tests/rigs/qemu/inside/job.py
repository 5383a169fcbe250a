"""The guest's job: run the cases, print what they found, and send it out as JSON."""

from __future__ import annotations

import faulthandler
import json
import logging
import sys
import time
import traceback
from pathlib import Path

from qemu.inside import serial_cases, systemd_cases, usb_cases

RESULTS = Path("/dev/ttyS1")
CASE_TIMEOUT_S = 90
SERVICE_TIMEOUT_S = 1200  # several starts of the daemon, half a minute each
CASES = {case.__name__: case for case in (*serial_cases.CASES, *usb_cases.CASES)}
SERVICE_CASES = {case.__name__: case for case in systemd_cases.CASES}


def main(names: list[str]) -> int:
    """Run all cases, or those named; a case that hangs ends the job, with a traceback.

    Those under systemd are run by name only: they need another guest.
    """
    logging.basicConfig(format="    %(name)s: %(message)s", level=logging.WARNING)
    failures = 0
    with RESULTS.open("w") as out:
        for name in names or CASES:
            patience_s = SERVICE_TIMEOUT_S if name in SERVICE_CASES else CASE_TIMEOUT_S
            faulthandler.dump_traceback_later(patience_s, exit=True)
            print(f"== {name}", flush=True)
            started_s = time.monotonic()
            try:
                result = (CASES | SERVICE_CASES)[name]()
            except Exception:  # noqa: BLE001 the host shows it, and the other cases shall run
                result = {"error": traceback.format_exc()}
                failures += 1
            result["seconds"] = round(time.monotonic() - started_s, 2)
            for key, value in result.items():
                print(f"   {key}: {value}", flush=True)
            out.write(json.dumps({name: result}) + "\n")
            out.flush()
    faulthandler.cancel_dump_traceback_later()
    return min(failures, 1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
