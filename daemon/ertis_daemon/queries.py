"""Queries of one sonar: answered from what was published last, or obeyed."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from ertis_daemon.events import dump_json
from ertis_daemon.zenoh_session import one_line
from ertis_driver.closing import Closing
from ertis_driver.errors import ErtisError

log = logging.getLogger(__name__)

POLL_S = 0.02  # what a query waits for at most
WAITING = 16  # of each kind; the oldest is dropped and ends empty
JOIN_S = 1.0
JSON = "application/json"

MAX_PARAMETERS = 16
Obey = Callable[[str, Mapping[str, str]], Mapping[str, Any]]
COMMANDS = ("ping", "record", "reload")


class CommandError(ErtisError):
    """A command cannot be obeyed: correct it, as it says."""


class Answers(Closing):
    """Answers queries in a thread of its own.

    By channels and polling, not by callbacks: a process with a callback that nobody undeclared
    would never exit (zenoh-python#434).

    Parameters
    ----------
    session
        Open.
    base
        Prefix of the keys.
    names
        Answered with what ``set`` was last given for them; with nothing before that.
    obey
        What to do with a command and its parameters; it returns what to reply. None: there are no
        commands.
    """

    def __init__(
        self,
        session: zenoh.Session,
        base: str,
        names: tuple[str, ...],
        obey: Obey | None = None,
    ) -> None:
        self._base = base
        self._obey = obey
        self._values: dict[str, tuple[bytes, str]] = {}  # replaced whole: no lock needed
        self._done = threading.Event()
        commands = tuple(f"cmd/{name}" for name in COMMANDS) if obey else ()
        self._queryables = {
            name: session.declare_queryable(f"{base}/{name}", zenoh.handlers.RingChannel(WAITING))
            for name in (*names, *commands)
        }
        self._thread = threading.Thread(target=self._run, name=f"queries {base}", daemon=True)
        self._thread.start()

    def set(self, name: str, data: bytes, encoding: str = JSON) -> None:
        """Answer queries for a name with this from now on."""
        self._values[name] = (data, encoding)

    def close(self) -> None:
        """Answer no more. May be called twice."""
        self._done.set()
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)
        for queryable in self._queryables.values():
            queryable.undeclare()  # type: ignore[no-untyped-call]
        self._queryables = {}

    def _run(self) -> None:
        while not self._done.wait(POLL_S):
            for name, queryable in tuple(self._queryables.items()):
                try:
                    while (query := queryable.try_recv()) is not None:
                        self._answer(name, query)
                except zenoh.ZError as error:
                    log.warning("a query for %s went unanswered: %s", name, one_line(error))
                except Exception:
                    log.exception("a query for %s went unanswered", name)

    def _answer(self, name: str, query: zenoh.Query) -> None:
        with query:  # dropped at the end, so that the asker's get ends
            if name.startswith("cmd/"):
                self._command(name, query)
            elif name in self._values:
                data, encoding = self._values[name]
                query.reply(f"{self._base}/{name}", data, encoding=encoding)

    def _command(self, name: str, query: zenoh.Query) -> None:
        assert self._obey is not None
        command = name.removeprefix("cmd/")
        try:
            parameters = _parameters(query)
            reply = self._obey(command, parameters)
        except Exception as error:
            if not isinstance(error, ErtisError):
                log.exception("command %s failed", command)
            query.reply_err(dump_json({"error": str(error)}), encoding=JSON)
            return
        query.reply(f"{self._base}/{name}", dump_json(reply), encoding=JSON)


def _parameters(query: zenoh.Query) -> dict[str, str]:
    text = str(query.parameters)
    pairs = [part.partition("=") for part in text.split(";") if part]
    if len(pairs) > MAX_PARAMETERS:
        raise CommandError(f"{len(pairs)} parameters, expected {MAX_PARAMETERS} or fewer")
    return {key: value for key, _, value in pairs}
