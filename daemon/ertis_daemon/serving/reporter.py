"""Status messages: once a second, and at once when something is worth it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from ertis_daemon.serving.outputs import Publisher
from ertis_daemon.status import Status

PERIOD_S = 1.0


def _nothing() -> Mapping[str, Any]:
    return {}


class Reporter:
    """Publishes a status. For one thread at a time.

    Parameters
    ----------
    status, publisher
        What, and where to.
    around
        Called for each message; what it returns is added (the network's state, for example).
    """

    def __init__(
        self,
        status: Status,
        publisher: Publisher,
        around: Callable[[], Mapping[str, Any]] = _nothing,
    ) -> None:
        self._status = status
        self._publisher = publisher
        self._around = around
        self._due_s = 0.0
        self._said: tuple[Any, ...] = ()

    def tick(self) -> None:
        """Publish if it is time to, or if there is news."""
        if time.monotonic() >= self._due_s or self._status.words() != self._said:
            self.publish()

    def publish(self) -> None:
        """Publish now."""
        self._due_s = time.monotonic() + PERIOD_S
        self._said = self._status.words()
        self._publisher.publish_status({**self._status.to_json(), **self._around()})
