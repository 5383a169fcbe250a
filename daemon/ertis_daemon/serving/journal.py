"""Log lines on stderr: for a person, or with the priority that journald reads off their front."""

from __future__ import annotations

import logging
import os
import sys
from typing import IO

# Level to priority, as in syslog(3) and sd-daemon(3).
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG = 7


class JournalFormatter(logging.Formatter):
    """``<4>ertis_daemon.service: ...``, the priority in front of each line of a message."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of a record."""
        fitting = (number for level, number in _PRIORITIES if record.levelno >= level)
        priority = next(fitting, _DEBUG)
        return "\n".join(f"<{priority}>{line}" for line in super().format(record).splitlines())


def is_journal(stream: IO[str]) -> bool:
    """Whether what is written there goes to journald: it says so in JOURNAL_STREAM."""
    try:
        state = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or no file
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{state.st_dev}:{state.st_ino}"


def log_to_stderr(*, verbose: bool) -> None:
    """Send all log lines to stderr."""
    handler = logging.StreamHandler(sys.stderr)
    if is_journal(sys.stderr):
        handler.setFormatter(JournalFormatter("%(name)s: %(message)s"))
    else:
        handler.setFormatter(logging.Formatter("%(levelname).1s %(name)s: %(message)s"))
    logging.basicConfig(level=logging.DEBUG if verbose else logging.INFO, handlers=[handler])
