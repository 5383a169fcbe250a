"""The counters for Prometheus; needs the extra ``prometheus``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from ertis_daemon.status import Status
from ertis_daemon.zenoh_session import PublisherError

# Those that never fall; all other numbers of a status are gauges.
COUNTERS = (
    *("pings_heard", "pings_lost", "frames_corrupt", "timeouts", "pings_away", "queue_drops"),
    *("half_words_repaired", "pings_failed", "events", "clock_steps", "starts", "recordings"),
    *("recordings_failed", "publish_failures"),
)


class StatusCollector:
    """Makes metrics of the statuses, each time that they are asked for."""

    def __init__(self, statuses: Callable[[], Mapping[str, Status]]) -> None:
        self._statuses = statuses

    def collect(self) -> Iterator[Any]:
        """Yield one metric after the other, with a sample a sonar."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        told = {name: _numbers(status) for name, status in self._statuses().items()}
        for key in next(iter(told.values()), {}):
            is_counter = key in COUNTERS
            kind = CounterMetricFamily if is_counter else GaugeMetricFamily
            family = kind(f"ertis_{key}", f"{key} of EVENTS.md", labels=["sonar"])
            for name, numbers in told.items():
                family.add_metric([name], numbers[key])
            yield family


def _numbers(status: Status) -> dict[str, float]:
    values = status.to_json()
    numbers = {
        key: math.nan if value is None else float(value)
        for key, value in values.items()
        if value is None or isinstance(value, (int, float))
    }
    numbers["microphones_faulty"] = float(len(values["microphones_faulty"]))
    numbers["outputs_failing"] = float(len(values["outputs_failing"]))
    numbers["is_running"] = float(values["state"] == "running")
    return numbers


@contextmanager
def serve_metrics(
    listen: str, statuses: Callable[[], Mapping[str, Status]]
) -> Iterator[tuple[str, int]]:
    """Serve ``/metrics`` in a thread; yields host and port.

    Parameters
    ----------
    listen
        ``HOST:PORT``; port 0 is any free one.

    Raises
    ------
    PublisherError
        If the extra is not installed, or the port is taken.
    """
    try:
        from prometheus_client import start_http_server
        from prometheus_client.registry import CollectorRegistry
    except ImportError as error:
        raise PublisherError(
            "prometheus.listen is set, but prometheus-client is not installed: pip install "
            "'ertis[prometheus]'"
        ) from error
    host, _, port = listen.rpartition(":")
    registry = CollectorRegistry()
    registry.register(StatusCollector(statuses))
    try:
        server, thread = start_http_server(int(port), host.strip("[]"), registry)
    except OSError as error:
        raise PublisherError(f"prometheus.listen {listen}: {error.strerror}") from error
    try:
        yield host, server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join(1.0)
