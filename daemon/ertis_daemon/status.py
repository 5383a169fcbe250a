"""How one sonar is doing, in numbers and words. EVENTS.md tells users what they mean."""

from __future__ import annotations

import dataclasses
import math
import statistics
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

LATENCIES_KEPT = 256
RATE_OVER_S = 5.0

State = Literal["starting", "waiting", "running", "away", "stalled", "failed", "ended"]


@dataclass(slots=True)
class Status:
    """Counters since the daemon started, and what is so now.

    Several threads count, each its own fields; nothing is counted by two.
    """

    device: str = ""
    state: State = "starting"
    reason: str = ""
    pings_heard: int = 0
    pings_lost: int = 0
    frames_corrupt: int = 0
    timeouts: int = 0
    pings_away: int = 0
    queue_drops: int = 0
    half_words_repaired: int = 0
    pings_failed: int = 0
    pings_without_odometry: int = 0
    odometry_garbled: int = 0
    events: int = 0
    clock_steps: int = 0
    starts: int = 0
    recordings: int = 0
    recordings_failed: int = 0
    publish_failures: int = 0
    outputs_failing: dict[str, str] = field(default_factory=dict)
    microphones_faulty: dict[str, str] = field(default_factory=dict)
    noise_dbfs: float | None = None
    model: str = ""
    source: str = ""
    temperature_c: float | None = None
    speed_of_sound_m_s: float | None = None
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES_KEPT))
    started_s: float = field(default_factory=time.monotonic)
    heard_s: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES_KEPT))

    def to_json(self) -> dict[str, Any]:
        """Return the counters, and percentiles of the last latencies, ms."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        recent = sorted(values.pop("latencies_ms"))
        values.pop("heard_s")
        values["microphones_faulty"] = dict(self.microphones_faulty)
        values["outputs_failing"] = dict(self.outputs_failing)
        values["uptime_s"] = round(time.monotonic() - values.pop("started_s"), 3)
        values["time_ns"] = time.time_ns()
        values["ping_rate_hz"] = self.ping_rate_hz()
        values["latency_median_ms"] = statistics.median(recent) if recent else None
        for percent in (90, 99):
            values[f"latency_p{percent}_ms"] = _percentile(recent, percent)
        values["latency_max_ms"] = recent[-1] if recent else None
        return values

    def ping_rate_hz(self) -> float:
        """Pings heard a second, over the last 5 s."""
        since_s = time.monotonic() - RATE_OVER_S
        recent = [at_s for at_s in tuple(self.heard_s) if at_s >= since_s]
        if len(recent) < 2:
            return 0.0
        return round((len(recent) - 1) / (recent[-1] - recent[0]), 3)

    def words(self) -> tuple[Any, ...]:
        """What is worth a message at once when it changes."""
        faulty = tuple(sorted(self.microphones_faulty.items()))
        failing = tuple(self.outputs_failing)
        counted = (self.clock_steps, self.starts, self.recordings, self.recordings_failed)
        return self.state, self.reason, faulty, failing, self.model, self.source, counted


def _percentile(ordered: list[float], percent: int) -> float | None:
    if not ordered:
        return None
    return ordered[math.ceil(percent / 100 * len(ordered)) - 1]
