"""What a soak run says: slopes, percentiles, a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

WARM_UP = 0.2  # of the run: caches fill


def slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Least-squares slope after the warm-up, and its standard error."""
    start = int(WARM_UP * len(x))
    x, y = x[start:], y[start:]
    if len(x) < 3 or np.ptp(x) == 0:
        return float("nan"), float("nan")
    (rate, _level), (spread,), *_ = (*np.polyfit(x, y, 1, full=True)[:2], None)
    if np.size(spread) == 0:
        return float(rate), 0.0
    error = np.sqrt(spread / (len(x) - 2) / np.sum((x - x.mean()) ** 2))
    return float(rate), float(error)


def percentiles(values: list[float]) -> str:
    """Median, 90, 99, 99.9 % and greatest."""
    if not values:
        return "none"
    p = np.percentile(values, [50, 90, 99, 99.9, 100])
    names = ("p50", "p90", "p99", "p99.9", "max")
    return "  ".join(f"{name} {value:.1f}" for name, value in zip(names, p, strict=True))


def summarize(
    samples: list[dict], latencies_ms: list[float], transits_ms: list[float], ready_s: float
) -> str:
    """The run in a few lines."""
    told = [one for one in samples if "pings_heard" in one]
    if len(told) < 2:
        return "the daemon said nothing"
    first, last = told[0], told[-1]
    pings = np.array([one["pings_heard"] for one in told], float)
    took_s = last["t_s"] - first["t_s"]
    cpu_s = last["cpu_s"] - first["cpu_s"]
    lines = [
        f"{last['pings_heard']} pings in {last['t_s']:.0f} s, {last['events']} events; lost "
        f"{last['pings_lost']}, dropped {last['queue_drops']}, failed {last['pings_failed']}, "
        f"timeouts {last['timeouts']}",
        f"start to READY {ready_s:.2f} s, processor {cpu_s / took_s:.2f} of a core, "
        f"{1e3 * cpu_s / (pings[-1] - pings[0]):.1f} ms a ping",
    ]
    for key, unit in (("rss_mb", "MB"), ("threads", ""), ("fds", "")):
        values = np.array([one[key] for one in told], float)
        rate, error = slope(pings, values)
        lines.append(
            f"{key}: {values[0]:.1f} at first, {values[-1]:.1f} {unit} at last; slope "
            f"{1e5 * rate:+.3f} +- {1e5 * error:.3f} {unit} per 100000 pings"
        )
    daemon = [one["latency_p99_ms"] for one in told if one.get("latency_p99_ms")]
    medians = [one["latency_median_ms"] for one in told if one.get("latency_median_ms")]
    lines += [
        f"last byte to publication, ms: median {np.median(medians):.1f}, p99 of 256 events: median "
        f"{np.median(daemon):.1f}, worst {max(daemon):.1f}",
        f"publication to reader, ms: {percentiles(transits_ms)}",
        f"trigger to reader, ms: {percentiles(latencies_ms)}",
    ]
    return "\n".join(lines)


def draw(samples: list[dict], latencies_ms: list[float], path: Path) -> None:
    """Memory, threads, descriptors and latency over the run."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    told = [one for one in samples if "pings_heard" in one]
    pings = [one["pings_heard"] for one in told]
    figure, axes = plt.subplots(4, 1, figsize=(8, 9), sharex=False, layout="constrained")
    for axis, key, unit in zip(axes, ("rss_mb", "threads", "fds"), ("MB", "", ""), strict=False):
        axis.plot(pings, [one[key] for one in told])
        axis.set_ylim(0, 1.2 * max(one[key] for one in told))
        axis.set_ylabel(f"{key.removesuffix('_mb')} {unit}")
        axis.set_xlabel("pings")
    axes[3].hist(latencies_ms, bins=200, log=True)
    axes[3].set_xlabel("trigger to reader, ms")
    axes[3].set_ylabel("events")
    figure.savefig(path, dpi=120)
