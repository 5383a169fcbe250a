"""What a soak run says: a table of figures and targets, slopes, a picture."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

WARM_UP = 0.2  # of the run: caches fill
LATENCY_MS, CORE, RSS_MB, READY_S = 36.0, 0.40, 120.0, 2.0  # what is asked for
ROW = "{:44} {:>34}  {}"


def summarize(about: dict, samples: list[dict]) -> str:
    """The run as a table."""
    told = [one for one in samples if "pings_heard" in one]
    if len(told) < 3:
        return "the daemon said nothing"
    first, last = told[0], told[-1]
    published, reader, trigger = _latencies(told)
    pings = last["pings_heard"] - first["pings_heard"]
    took_s = last["t_s"] - first["t_s"]
    user_s, system_s, busy_s, stolen_s = (
        last[key] - first[key] for key in ("user_s", "system_s", "busy_s", "stolen_s")
    )
    calm = _undisturbed(told)
    calm_s = sum(now["t_s"] - before["t_s"] for before, now in calm)
    calm_core = sum(_used_s(now) - _used_s(before) for before, now in calm) / max(calm_s, 1e-9)
    core = (user_s + system_s) / took_s
    floor, is_paced = about["floor"], bool(about["rate_hz"])
    latest = f"p99 <= {LATENCY_MS:g}" * is_paced
    lines = [
        f"{last['pings_heard']} pings in {last['t_s']:.0f} s ({pings / took_s:.1f} a second), "
        f"{len(reader)} events read; lost "
        f"{last['pings_lost']}, dropped {last['queue_drops']}, failed {last['pings_failed']}, "
        f"timeouts {last['timeouts']}",
        f"all processes of the machine together: {busy_s / took_s:.2f} cores in the mean; its host "
        f"took away {stolen_s / took_s:.2f} more, and none in {100 * calm_s / took_s:.0f} % of "
        "the seconds",
        *(() if is_paced else ("as fast as it goes, a ping waits for those before it",)),
        ROW.format("", "seen", "asked"),
        ROW.format("last byte to publication, ms", percentiles(published), ""),
        ROW.format("last byte to reader, ms", percentiles(reader), latest),
        ROW.format(
            "  in seconds that nothing was taken from",
            percentiles(_latencies([now for _, now in calm])[1]),
            "",
        ),
        ROW.format("trigger to reader, ms", percentiles(trigger), ""),
        ROW.format(
            f"last byte to reader within {LATENCY_MS:g} ms",
            f"{100 * np.mean(reader <= LATENCY_MS):.2f} %" if len(reader) else "none",
            "",
        ),
        ROW.format(
            "processor, of a core",
            f"{core:.2f} ({1e3 * user_s / pings:.1f} user + {1e3 * system_s / pings:.1f} system ms "
            "a ping)",
            f"<= {CORE:g}" * is_paced,
        ),
        ROW.format("  in seconds that nothing was taken from", f"{calm_core:.2f}", ""),
        ROW.format(
            "  a bare reader of the same bytes, ms a ping",
            f"{floor['user_ms']:.1f} user + {floor['system_ms']:.1f} system",
            "",
        ),
        ROW.format("memory, MB", f"{max(o['rss_mb'] for o in told):.1f} at most", f"<= {RSS_MB:g}"),
        ROW.format("start to READY, s", f"{about['ready_s']:.2f}", f"<= {READY_S:g}"),
    ]
    heard = np.array([one["pings_heard"] for one in told], float)
    for key, unit in (("rss_mb", " MB"), ("threads", ""), ("fds", "")):
        values = np.array([one[key] for one in told], float)
        rate, error = slope(heard, values)
        lines.append(
            ROW.format(
                f"{key}: {values[0]:.1f} at first, {values[-1]:.1f} at last",
                f"{1e5 * rate:+.3f} +- {1e5 * error:.3f}{unit} per 100000 pings",
                "no growth",
            )
        )
    return "\n".join(lines)


def _undisturbed(told: list[dict]) -> list[tuple[dict, dict]]:
    """A sample and that before it, where the machine's host took no processor time between."""
    return [both for both in pairwise(told) if both[0]["stolen_s"] == both[1]["stolen_s"]]


def _used_s(sample: dict) -> float:
    return sample["user_s"] + sample["system_s"]


def slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Least-squares slope after the warm-up, and its standard error."""
    start = int(WARM_UP * len(x))
    x, y = x[start:], y[start:]
    if len(x) < 3 or np.ptp(x) == 0:
        return float("nan"), float("nan")
    (rate, level), spread = np.polyfit(x, y, 1), 0.0
    spread = float(np.sum((y - rate * x - level) ** 2))
    error = np.sqrt(spread / (len(x) - 2) / np.sum((x - x.mean()) ** 2))
    return float(rate), float(error)


def percentiles(values: np.ndarray) -> str:
    """Median, 90, 99, 99.9 % and greatest."""
    if not len(values):
        return "none"
    p = np.percentile(values, [50, 90, 99, 99.9, 100])
    names = ("p50", "p90", "p99", "p99.9", "max")
    return " ".join(f"{name} {value:.1f}" for name, value in zip(names, p, strict=True))


def draw(about: dict, samples: list[dict], path: Path) -> None:
    """Latency over time and as a histogram, processor, memory, threads and descriptors."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    told = [one for one in samples if "pings_heard" in one]
    if len(told) < 3:
        return
    figure, axes = plt.subplots(3, 2, figsize=(11, 9), layout="constrained")
    minutes = np.array([one["t_s"] for one in told]) / 60
    _, reader, _ = _latencies(told)
    _draw_latencies(axes[0, 0], told)
    _draw_histogram(axes[0, 1], reader)
    if about["rate_hz"]:  # else a ping waits for those before it
        axes[0, 0].axhline(LATENCY_MS, color="tab:red", ls="--", lw=1, label="p99 asked for")
        axes[0, 1].axvline(LATENCY_MS, color="tab:red", ls="--", lw=1, label="p99 asked for")
    for axis in axes[0]:
        axis.legend(fontsize="small")
    cpu = np.array([_used_s(one) for one in told])
    axes[1, 0].plot(minutes[1:], np.diff(cpu) / np.diff(60 * minutes), lw=0.8)
    if about["rate_hz"]:
        axes[1, 0].axhline(CORE, color="tab:red", ls="--", lw=1)
    axes[1, 0].set(xlabel="minutes", ylabel="processor, of a core", ylim=(0, None))
    axes[1, 1].plot(minutes, [one["rss_mb"] for one in told])
    axes[1, 1].axhline(RSS_MB, color="tab:red", ls="--", lw=1)
    axes[1, 1].set(xlabel="minutes", ylabel="memory (RSS), MB", ylim=(0, 1.1 * RSS_MB))
    for axis, key, name in zip(
        axes[2], ("threads", "fds"), ("threads", "file descriptors"), strict=True
    ):
        axis.plot([one["pings_heard"] for one in told], [one[key] for one in told])
        axis.set(xlabel="pings", ylabel=name, ylim=(0, 1.2 * max(one[key] for one in told)))
    figure.suptitle(f"{told[-1]['pings_heard']} pings of an emulated sonar on a pty")
    figure.savefig(path, dpi=110)


def _draw_latencies(axis, told: list[dict]) -> None:
    """Each second's median and greatest."""
    some = [one for one in told if one["heard"]]
    minutes = [one["t_s"] / 60 for one in some]
    each = [[ms for _, ms, _ in one["heard"]] for one in some]
    axis.plot(minutes, [max(ms) for ms in each], ".", ms=2, label="greatest of each second")
    axis.plot(minutes, [np.median(ms) for ms in each], lw=0.8, label="median of each second")
    axis.set(xlabel="minutes", ylabel="last byte to reader, ms", yscale="log")


def _draw_histogram(axis, latencies_ms: np.ndarray) -> None:
    if len(latencies_ms):
        least, most = max(latencies_ms.min(), 0.1), latencies_ms.max()
        axis.hist(latencies_ms, bins=np.geomspace(0.95 * least, 1.05 * most, 150), log=True)
        axis.axvline(np.percentile(latencies_ms, 99), color="k", lw=1, label="p99")
    axis.set(xlabel="last byte to reader, ms", ylabel="events", xscale="log")


def _latencies(told: list[dict]) -> np.ndarray:
    """Shape (3, num_events), ms: last byte to publication and to reader, trigger to reader."""
    return np.array([row for one in told for row in one["heard"]], float).reshape(-1, 3).T
