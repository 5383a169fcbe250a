"""The detector's page, table and JSON: range not told."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ertis_daemon.report.detector_data import DetectorReport
from ertis_daemon.report.detector_drawings import (
    draw_curve,
    draw_errors,
    draw_over,
    draw_reliability_and_sizes,
    draw_seconds,
)
from ertis_daemon.report.drawing import svg
from ertis_daemon.report.page import Page
from ertis_detector.accuracy import AXES
from ertis_detector.evaluate import Evaluation, Rate
from ertis_detector.intervals import Interval, garwood

PERIOD_MS = 36.4  # of a ping at the device's 27.5 Hz


def text(report: DetectorReport) -> str:
    """The figures, for a terminal."""
    rows = [*_found_rows(report.evaluation), *_figure_rows(report.evaluation)]
    width = max(len(row[0]) for row in rows)
    return "\n".join([_about(report), *(f"{row[0].ljust(width)}  {_tail(row)}" for row in rows)])


def as_json(report: DetectorReport) -> dict[str, Any]:
    """Everything that the page shows, as JSON takes it: shares of 1, SI units, no NaN."""
    told = report.evaluation
    place, false, calibration = told.place, told.false_alarms, told.reliability
    return {
        "data": [{"name": name, "digest": digest} for name, digest in report.data],
        "sources": list(report.sources),
        "chirps": list(report.chirps),
        "model": report.model,
        "model_source": report.model_source,
        "model_data": report.model_data,
        "trained_on": list(report.met_before),
        "pings": told.num_pings,
        "groups": told.num_groups,
        "threshold": told.threshold,
        "conditions": {
            name: {"located": _rate_json(one.located), "right_size": _rate_json(one.right_size)}
            for name, one in told.conditions.items()
        },
        "over": {
            name: [
                {
                    "low": low,
                    "high": high,
                    "located": _rate_json(one.located),
                    "right_size": _rate_json(one.right_size),
                }
                for low, high, one in bins
            ]
            for name, bins in told.over.items()
        },
        "curve": [
            {
                "threshold": _number(one.threshold),
                "located": _number(one.located),
                "right_size": _number(one.right_size),
                "precision": _number(one.precision),
                "false_per_free_ping": _number(one.false_per_free_ping),
            }
            for one in told.curve
        ],
        "false_alarms": {
            "free_pings": false.free_pings,
            "on_free": false.on_free,
            "rate_hz": false.rate_hz,
            "per_minute": _number(false.per_minute),
            "interval": _interval_json(false.interval),
            "elsewhere": false.elsewhere,
        },
        "sizes": list(told.sizes),
        "size_confusion": told.size_confusion.tolist(),
        "calibration": {
            "expected_error": _number(calibration.expected_error),
            "interval": _interval_json(calibration.interval),
            "bins": [
                {"told": _number(one.told), "came_true": _number(one.came_true), "count": one.count}
                for one in calibration.bins
            ],
            "other_environments_known": None
            if told.recalibrated is None
            else {
                "expected_error": _number(told.recalibrated.expected_error),
                "interval": _interval_json(told.recalibrated.interval),
            },
        },
        "place": {
            "located": place.count,
            "bias": dict(zip(AXES, map(_number, place.bias), strict=True)),
            "rms": dict(zip(AXES, map(_number, place.rms), strict=True)),
            "range_bias_by_size_m": {
                name: _number(value) for name, value in place.range_bias_by_size_m.items()
            },
            "range_sigma_m": _number(place.range_sigma_m),
            "nees": _number(place.nees),
            "nees_dimensions": place.nees_dimensions,
            "nees_band": _interval_json(place.nees_band),
            "nees_by_axis": dict(zip(AXES, map(_number, place.nees_by_axis), strict=True)),
            "tilt_rmse_rad": _number(place.tilt_rmse_rad),
            "tilts": place.tilts,
        },
        "seconds_per_ping": {name: _number(value) for name, value in _seconds(told).items()},
    }


def page(report: DetectorReport, command: str) -> Page:
    """The page."""
    told = report.evaluation
    made = Page("Landmarks found with the range not told, ping by ping")
    made.sources(report.sources)
    made.text(_about(report))
    made.code(command)
    made.table(
        ("landmarks that", "asked", "located", "located, right size"),
        _found_rows(told),
        "Percent of landmarks, at the threshold. ( ): 95 % as if each ping were alone (Wilson); "
        "[ ]: 95 % with whole groups (sessions or scenes) drawn again. Located is within 15 cm "
        "and 6 degrees of the true vertex.",
    )
    made.table(("figure", "value"), _figure_rows(told))
    made.text(_needed(told))
    made.heading("Over the reporting threshold")
    made.figure(
        svg(lambda axes: draw_curve(axes, told), 9, 3.4, columns=2),
        "Left: precision and recall as the threshold moves; the ring is the threshold used. "
        "Right: false reports on landmark-free pings, as a rate.",
    )
    made.heading("Over range, azimuth, tilt and signal-to-clutter")
    made.figure(
        svg(lambda axes: draw_over(axes, told), 9, 6.4, rows=2, columns=2),
        "Landmarks that can be heard. Bars are 95 % (Wilson), small numbers how many there were. "
        "Signal-to-clutter: the dish's echo against everything else in its fragment.",
    )
    made.heading("Probabilities and sizes")
    made.figure(
        svg(lambda axes: draw_reliability_and_sizes(axes, told), 9, 4.2, columns=2),
        "Left: how often a report of some probability was right in place and size, reports under "
        "the threshold included; on the line they are true. Right: sizes of located landmarks.",
    )
    made.heading("Where they were said to be")
    made.table(
        ("reported size", "mean range error, mm"),
        [(name, f"{1000 * value:+.1f}") for name, value in told.place.range_bias_by_size_m.items()],
    )
    made.figure(
        svg(lambda axes: draw_errors(axes, told), 9, 3.2, columns=3),
        "Errors of located landmarks, told less true; the line is what the mean reported variance "
        "promises.",
    )
    made.heading("Time")
    made.figure(
        svg(lambda axes: draw_seconds(axes, told), 9, 2.6),
        f"Processor time of one thread for one ping, audio to detections. A ping lasts "
        f"{PERIOD_MS} ms.",
    )
    made.heading("What was judged")
    made.table(
        ("", ""),
        [
            ("model", report.model),
            ("trained on", f"{report.model_source}: {report.model_data}"),
            ("chirp", ", ".join(report.chirps)),
            *(("data", f"{name}, {digest}") for name, digest in report.data),
        ],
    )
    return made


def _about(report: DetectorReport) -> str:
    told = report.evaluation
    simulated = "simulated " if report.sources == ("sim",) else ""
    met = (
        f". THE MODEL WAS TRAINED ON {', '.join(report.met_before)}: these figures flatter it"
        if report.met_before
        else ""
    )
    return (
        f"{told.num_pings} {simulated}pings in {told.num_groups} groups of "
        f"{', '.join(name for name, _ in report.data)}; model {report.model}, trained on "
        f"{'simulated' if report.model_source == 'sim' else report.model_source} echoes; "
        f"threshold {told.threshold:g}{met}"
    )


def _tail(row: tuple[str, ...]) -> str:
    if len(row) == 2:
        return row[1]
    return f"of {row[1]}: located {row[2]}; right size {row[3]}"


def _found_rows(told: Evaluation) -> list[tuple[str, ...]]:
    return [
        (name, str(one.located.trials), _rate(one.located), _rate(one.right_size))
        for name, one in told.conditions.items()
        if one.located.trials
    ]


def _rate(one: Rate) -> str:
    low, high = one.independent
    text = f"{100 * one.share:.1f} ({100 * low:.1f}, {100 * high:.1f})"
    low, high = one.clustered
    return text if math.isnan(low) else f"{text} [{100 * low:.1f}, {100 * high:.1f}]"


def _figure_rows(told: Evaluation) -> list[tuple[str, str]]:
    place, false, calibration = told.place, told.false_alarms, told.reliability
    seconds = _seconds(told)
    return [
        ("false reports on landmark-free pings", _false(told)),
        ("false reports beside landmarks", str(false.elsewhere)),
        (
            "expected calibration error",
            f"{_percent(calibration.expected_error)}{_percents(calibration.interval)} of "
            f"{sum(one.count for one in calibration.bins)} reports, under the threshold too",
        ),
        (
            "the same, environment left out: slope and offset of log odds from all others",
            "needs two environments or more"
            if told.recalibrated is None
            else _percent(told.recalibrated.expected_error) + _percents(told.recalibrated.interval),
        ),
        (
            "range",
            f"{_millimetres(place.rms[0])} RMS; {_millimetres(place.range_sigma_m)} (1 sigma) with "
            "each size's mean taken out",
        ),
        (
            "azimuth, elevation",
            f"{np.rad2deg(place.rms[1]):.2f} and {np.rad2deg(place.rms[2]):.2f} degrees RMS"
            if place.count
            else "not known",
        ),
        (
            f"NEES ({place.nees_dimensions} dimensions, {place.count} located)",
            f"{place.nees:.2f}; true covariances give {place.nees_band[0]:.2f} to "
            f"{place.nees_band[1]:.2f}; range, azimuth, elevation alone (1 is true) "
            + ", ".join(f"{one:.2f}" for one in place.nees_by_axis)
            if place.count
            else "not known",
        ),
        (
            "tilt",
            f"{np.rad2deg(place.tilt_rmse_rad):.1f} degrees RMSE of {place.tilts} told"
            if place.tilts
            else "never told",
        ),
        (
            "processor time a ping (one thread)",
            f"{1000 * seconds['median']:.1f} ms median, {1000 * seconds['p95']:.1f} ms 95th "
            f"percentile, {1000 * seconds['most']:.1f} ms at most",
        ),
    ]


def _false(told: Evaluation) -> str:
    false = told.false_alarms
    if false.free_pings == 0:
        return "not known: every ping holds a landmark"
    low, high = false.interval
    return (
        f"{false.on_free} in {false.free_pings}: {false.per_minute:.2f} a minute at "
        f"{false.rate_hz:g} Hz [{low:.2f}, {high:.2f}]"
    )


def _needed(told: Evaluation) -> str:
    """How much silence a small rate of false alarms takes to be shown."""
    rate_hz = told.false_alarms.rate_hz
    minute, hour = (math.ceil(garwood(0, 1.0)[1] * rate_hz * seconds) for seconds in (60, 3600))
    return (
        f"Without any false report, at {rate_hz:g} Hz it takes {minute} landmark-free pings to "
        f"show fewer than one a minute, and {hour} to show fewer than one an hour (95 %, "
        "two-sided, exact Poisson); pings of one place are less than independent."
    )


def _seconds(told: Evaluation) -> dict[str, float]:
    if told.seconds.size == 0:
        return dict.fromkeys(("median", "p95", "most"), math.nan)
    median, high = np.percentile(told.seconds, (50, 95))
    return {"median": float(median), "p95": float(high), "most": float(told.seconds.max())}


def _millimetres(value_m: float) -> str:
    return "not known" if math.isnan(value_m) else f"{1000 * value_m:.1f} mm"


def _percent(value: float) -> str:
    return "not known" if math.isnan(value) else f"{100 * value:.1f} %"


def _percents(interval: Interval) -> str:
    low, high = interval
    return "" if math.isnan(low) else f" [{100 * low:.1f}, {100 * high:.1f}]"


def _rate_json(one: Rate) -> dict[str, Any]:
    return {
        "successes": one.successes,
        "trials": one.trials,
        "share": _number(one.share),
        "wilson": _interval_json(one.independent),
        "clustered": _interval_json(one.clustered),
    }


def _interval_json(interval: Interval) -> list[float | None]:
    return [_number(value) for value in interval]


def _number(value: float) -> float | None:
    return None if math.isnan(value) else round(float(value), 6)
