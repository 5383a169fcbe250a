"""What the project's own code does with the emulated device; prints what it met, as JSON."""

import faulthandler
import json
import sys
import time
import zlib

import usb.backend.libusb1

from ertis_driver.device import Settings
from ertis_driver.errors import ErtisError
from ertis_driver.open import open_device

HANGS_S = 60  # no case takes that long, whatever the load


def main(address, num_pings, options):
    met = []
    if options.pop("system_libusb", True):
        assert usb.backend.libusb1.get_backend() is not None  # pyusb keeps the first it loads
    try:
        with open_device(address, **options) as sonar:
            met.append(["open", sonar.info.address])
            sonar.configure(Settings(num_words=32_768))
            while len(met) < num_pings + 1:
                start_s = time.monotonic()
                try:
                    frame = sonar.ping()
                    met.append(["frame", frame.ping_index, zlib.crc32(frame.words.tobytes())])
                except ErtisError as error:
                    met.append([type(error).__name__, str(error), time.monotonic() - start_s])
            met.append(["reconnects", getattr(sonar, "reconnects", 0)])
    except ErtisError as error:
        met.append([type(error).__name__, str(error)])
    print(json.dumps(met))


faulthandler.dump_traceback_later(HANGS_S, exit=True)
main(sys.argv[1], int(sys.argv[2]), json.loads(sys.argv[3]))
