"""Where events, status and frames of one sonar go."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, Protocol

from ertis_daemon.events import LandmarkEvent
from ertis_driver.closing import Closing
from ertis_driver.frame import PdmFrame


class Publisher(Protocol):
    """One way out."""

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Take who publishes, and how it is configured; again after each change."""

    def publish(self, event: LandmarkEvent) -> None:
        """Publish an event."""

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish the counters."""

    def publish_raw(self, frame: PdmFrame) -> None:
        """Publish a whole frame, if that is wanted."""

    def close(self) -> None:
        """Leave. May be called twice."""


class FanOut(Closing):
    """Several ways out as one. What fails on one still goes out on the others."""

    def __init__(self, publishers: Sequence[Publisher]) -> None:
        self._publishers = tuple(publishers)

    def describe(self, info: Mapping[str, Any], effective_config: Mapping[str, Any]) -> None:
        """Tell each."""
        self._each(lambda one: one.describe(info, effective_config))

    def publish(self, event: LandmarkEvent) -> None:
        """Publish on each; the first error is raised after all had it."""
        self._each(lambda one: one.publish(event))

    def publish_status(self, status: Mapping[str, Any]) -> None:
        """Publish on each; the first error is raised after all had it."""
        self._each(lambda one: one.publish_status(status))

    def publish_raw(self, frame: PdmFrame) -> None:
        """Publish on each; the first error is raised after all had it."""
        self._each(lambda one: one.publish_raw(frame))

    def close(self) -> None:
        """Leave all."""
        self._each(lambda one: one.close())

    def _each(self, do: Callable[[Publisher], None]) -> None:
        with ExitStack() as stack:  # runs all of them, whatever one raises
            for one in reversed(self._publishers):
                stack.callback(do, one)
