"""Drawings of the detector's page."""

from __future__ import annotations

from typing import Any

import numpy as np

from ertis_daemon.report.drawing import COLOURS, confusion, with_interval
from ertis_detector.evaluate import Evaluation


def draw_curve(axes: Any, told: Evaluation) -> None:
    """Precision over recall, and false reports over the threshold."""
    left, right = axes[0]
    precision = [100 * one.precision for one in told.curve]
    for colour, label, recall in (
        (COLOURS[0], "located", [100 * one.located for one in told.curve]),
        (COLOURS[1], "located, right size", [100 * one.right_size for one in told.curve]),
    ):
        left.plot(recall, precision, color=colour, lw=1.3, marker=".", ms=4, label=label)
        used = next(n for n, one in enumerate(told.curve) if one.threshold == told.threshold)
        left.plot(recall[used], precision[used], "o", color=colour, mfc="none", ms=9)
    left.set(
        xlabel="% of landmarks that can be heard",
        ylabel="% of reports that are landmarks",
        xlim=(-2, 102),
        ylim=(-2, 102),
    )
    left.legend(loc="lower left")
    per_minute = [60 * told.false_alarms.rate_hz * one.false_per_free_ping for one in told.curve]
    right.plot([one.threshold for one in told.curve], per_minute, color=COLOURS[0], lw=1.3)
    right.axvline(told.threshold, color="#888", ls=":", lw=1)
    right.set(
        xlabel="reporting threshold",
        ylabel=f"false a minute at {told.false_alarms.rate_hz:g} Hz",
        yscale="symlog",
        ylim=(0, None),
        xlim=(0, 1),
    )


def draw_over(axes: Any, told: Evaluation) -> None:
    """Located and right over four variables."""
    for axis, (name, bins) in zip(axes.ravel(), told.over.items(), strict=True):
        middle = np.array([(low + high) / 2 for low, high, _ in bins])
        width = np.array([high - low for low, high, _ in bins])
        for colour, label, shift, rates in (
            (COLOURS[0], "located", -0.08, [one.located for _, _, one in bins]),
            (COLOURS[1], "right size", 0.08, [one.right_size for _, _, one in bins]),
        ):
            with_interval(
                axis,
                list(middle + shift * width),
                [100 * one.share for one in rates],
                [(100 * one.independent[0], 100 * one.independent[1]) for one in rates],
                color=colour,
                label=label,
            )
        for x, (_, _, one) in zip(middle, bins, strict=True):
            axis.text(x, 103, str(one.located.trials), ha="center", fontsize=7, color="#555")
        axis.set(xlabel=name, ylabel="%", ylim=(-2, 110), yticks=range(0, 101, 20))
    axes[0, 0].legend(loc="lower left", fontsize=8)


def draw_reliability_and_sizes(axes: Any, told: Evaluation) -> None:
    """Reliability diagram, and sizes' confusion."""
    left, right = axes[0]
    left.plot([0, 1], [0, 1], color="#888", lw=1, ls=":")
    bins = told.reliability.bins
    with_interval(
        left,
        [one.told for one in bins],
        [one.came_true for one in bins],
        [one.interval for one in bins],
        color=COLOURS[0],
    )
    for one in bins:
        left.annotate(
            str(one.count),
            (one.told, one.came_true),
            (6, -9),
            textcoords="offset points",
            fontsize=7,
            color="#555",
        )
    left.set(
        xlabel="probability told",
        ylabel="share that came true",
        xlim=(0, 1),
        ylim=(0, 1),
        aspect="equal",
    )
    if told.sizes:
        confusion(right, told.size_confusion, told.sizes, "sizes of located landmarks")
    else:
        right.text(0.5, 0.5, "nothing was located", ha="center")
        right.set_axis_off()


def draw_errors(axes: Any, told: Evaluation) -> None:
    """Histograms of errors, each with the normal law that its covariances promise."""
    place = told.place
    units = (
        ("range error, mm", 1000.0),
        ("azimuth error, degrees", float(np.rad2deg(1))),
        ("elevation error, degrees", float(np.rad2deg(1))),
    )
    for number, (axis, (name, scale)) in enumerate(zip(axes[0], units, strict=True)):
        errors = scale * place.errors[:, number]
        errors = errors[~np.isnan(errors)]
        axis.set(xlabel=name, ylabel="landmarks")
        if errors.size == 0:
            continue
        _, edges, _ = axis.hist(errors, bins=31, color=COLOURS[0], alpha=0.75)
        sigma = scale * place.sigmas[number]
        x = np.linspace(edges[0], edges[-1], 200)
        law = np.exp(-0.5 * (x / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
        axis.plot(x, law * errors.size * (edges[1] - edges[0]), color=COLOURS[1], lw=1.3)


def draw_seconds(axes: Any, told: Evaluation) -> None:
    """Time of each ping."""
    axis = axes[0, 0]
    axis.hist(1000 * told.seconds, bins=50, color=COLOURS[0], alpha=0.75)
    axis.set(xlabel="ms", ylabel="pings", xlim=(0, None))
