"""``python -m ertis_daemon.cli`` is ``ertis``."""

import sys

from ertis_daemon.cli import main

if __name__ == "__main__":
    sys.exit(main())
