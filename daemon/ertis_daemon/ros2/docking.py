"""Which landmark is the dock: one of the chosen class, and the same one as long as it is heard."""

from __future__ import annotations

import math

from ertis_daemon.events import LandmarkEvent, LandmarkReport

STALE_NS = 1_000_000_000  # Nav2's docking server gives up on a pose after this, too


class DockChooser:
    """Follows one landmark of a class.

    Parameters
    ----------
    label
        Its class, as in events: ``r35``, ``r48``, ...
    min_probability
        A report less sure of that class is no dock.
    """

    def __init__(self, label: str, min_probability: float) -> None:
        self._label = label
        self._min_probability = min_probability
        self._track_id: int | None = None
        self._heard_ns = 0

    def choose(self, event: LandmarkEvent, now_ns: int) -> LandmarkReport | None:
        """Return the dock, if this event tells where it is.

        The most probable landmark of the class is chosen, the nearer of two. Another one takes its
        place only when it was lost or not heard for a second: a robot on its way must not turn
        round to another dock. An event older than a second (a recording, a long queue) tells
        nothing of where the dock is now.

        Parameters
        ----------
        now_ns : int
            UNIX time on the clock that stamped the event.
        """
        if now_ns - event.ping_time_ns > STALE_NS:
            return None
        if event.ping_time_ns - self._heard_ns > STALE_NS:
            self._track_id = None
        if self._track_id in {r.track_id for r in event.landmarks if r.state == "lost"}:
            self._track_id = None
        fitting = [report for report in event.landmarks if self._fits(report)]
        if self._track_id is not None:
            fitting = [report for report in fitting if report.track_id == self._track_id]
        if not fitting:
            return None
        dock = max(fitting, key=lambda r: (r.probabilities.get(self._label, 0.0), -r.range_m))
        self._track_id, self._heard_ns = dock.track_id, event.ping_time_ns
        return dock

    def _fits(self, report: LandmarkReport) -> bool:
        return (
            report.state != "lost"
            and report.label == self._label
            and report.probabilities.get(self._label, 0.0) >= self._min_probability
            and math.isfinite(report.range_m)
            and math.isfinite(report.azimuth_rad)
        )
