"""Several publishers as one: what they say in JSON, in ROS messages, and so on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ertis_daemon.events import LandmarkEvent
from ertis_daemon.service import Publisher


class FanOut:
    """Gives everything to each; one that fails does not keep it from the others.

    Raises
    ------
    Exception
        What the first failing one raised, when all had their turn.
    """

    def __init__(self, *publishers: Publisher) -> None:
        self._publishers = publishers

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event."""
        self._each(lambda publisher: publisher.publish(event))

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the counters."""
        self._each(lambda publisher: publisher.publish_status(status))

    def close(self) -> None:
        """Leave. May be called twice."""
        self._each(lambda publisher: publisher.close())

    def _each(self, call: Callable[[Publisher], None]) -> None:
        first: Exception | None = None
        for publisher in self._publishers:
            try:
                call(publisher)
            except Exception as error:  # noqa: BLE001 raised below
                first = first or error
        if first is not None:
            raise first
