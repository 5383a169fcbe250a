"""How the service is doing, in numbers."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections import deque
from dataclasses import dataclass, field
from typing import Any

LATENCIES_KEPT = 256


@dataclass(slots=True)
class Status:
    """Counters since the service started. EVENTS.md tells users what they mean."""

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
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=LATENCIES_KEPT))

    def to_json(self) -> dict[str, Any]:
        """Return the counters, and median and 99th percentile of the last latencies, ms."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        recent = sorted(values.pop("latencies_ms"))
        values["latency_median_ms"] = statistics.median(recent) if recent else None
        values["latency_p99_ms"] = recent[math.ceil(0.99 * len(recent)) - 1] if recent else None
        return values
