"""The strict protocol's page, table and JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from ertis_daemon.report.drawing import COLOURS, confusion, svg, with_interval
from ertis_daemon.report.known_range import PAPER_FIGURES, KnownRangeReport
from ertis_daemon.report.page import Page
from ertis_detector.protocol import ENVIRONMENT, RANDOM, SESSION, TASKS, Accuracy, Outcome, gain

HEAD = ("landmark or none", "which landmark", "overall")


def text(report: KnownRangeReport) -> str:
    """The table protocol x method, for a terminal."""
    rows = [("", "", *HEAD), *_rows(report)]
    widths = [max(len(row[column]) for row in rows) for column in range(5)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    if report.sweep:
        told = _sweep_rows(report)
        wide = [max(len(row[column]) for row in told) for column in range(len(told[0]))]
        lines += ["", "one choice otherwise; gains in points:"]
        lines += [
            "  ".join(cell.ljust(width) for cell, width in zip(row, wide, strict=True)).rstrip()
            for row in told
        ]
    return "\n".join([_about(report), *lines])


def as_json(report: KnownRangeReport) -> dict[str, Any]:
    """Everything that the page shows, as JSON takes it: shares of 1, no NaN."""
    return {
        "protocol": "paper",
        "data": report.folder,
        "manifest": report.manifest_hash,
        "sources": list(report.sources),
        "chirps": list(report.chirps),
        "pings": len(report.labels.label),
        "pings_without_range": report.skipped,
        "environments": len(set(report.labels.environment)),
        "sessions": len(set(report.labels.session)),
        "choices": dataclasses.asdict(report.spec.choices),
        "repeats": report.spec.repeats,
        "folds": report.spec.folds,
        "seed": report.spec.seed,
        "always_the_commonest": dict(zip(TASKS, report.guesses, strict=True)),
        "methods": {
            name: {way: _outcome_json(one, report) for way, one in ways.items()}
            for name, ways in zip(report.methods, report.outcomes, strict=True)
        },
        "gains_over_the_first": {
            name: {way: _accuracies_json(told) for way, told in _gains(report, number).items()}
            for number, name in enumerate(report.methods)
            if number > 0
        },
        "sweep": [
            {
                "change": one.change,
                "gains": _accuracies_json(one.gains),
                one.split: _accuracies_json(one.outcome.accuracies),
            }
            for one in report.sweep
        ],
    }


def page(report: KnownRangeReport, command: str) -> Page:
    """The page."""
    made = Page("The paper's protocol: known range, one ping")
    made.sources(report.sources)
    made.text(_about(report))
    made.code(command)
    made.table(("method", "split", *HEAD), _rows(report), _CAPTION)
    made.text(_WHY)
    if ENVIRONMENT in report.outcomes[0]:
        made.text(_differences(report))
    made.figure(
        svg(lambda axes: _draw_accuracies(axes, report), 9, 3.2, columns=3),
        "Accuracy of each method by each way of splitting, with 95 % intervals (sessions drawn "
        "again). Dotted: always saying what is commonest.",
    )
    for name, ways in zip(report.methods, report.outcomes, strict=True):
        made.heading(f"Confusion: {name}")
        made.figure(
            svg(
                lambda axes, ways=ways: _draw_confusions(axes, ways, report),  # type: ignore[misc]
                9,
                3.3 * len(ways),
                rows=len(ways),
                columns=2,
            ),
            "Left: landmark present or not. Right: which landmark, asked wherever one stands. "
            "Percent of each row, and pings (of random folds: mean over the repeats).",
        )
    if ENVIRONMENT in report.outcomes[0]:
        made.heading("Environments, each asked by who heard all others")
        made.table(("environment", "method", *HEAD), _by_environment(report))
    if len(report.methods) > 1:
        made.heading(f"Gain over {report.methods[0]}, on the same pings")
        made.table(
            ("method", "split", *HEAD), _gain_rows(report), "Points; 95 % intervals, paired."
        )
    if report.sweep:
        made.heading("What each open choice matters")
        head, *rows = _sweep_rows(report)
        made.table(head, rows, _SWEEP_CAPTION)
    made.heading("How it was made")
    made.table(("choice", "value"), _choice_rows(report))
    return made


_CAPTION = (
    "Percent; ± is the standard deviation over the repeats (random folds: the paper's ±) or over "
    "the groups left out; [ ] is the 95 % interval with whole sessions drawn again."
)
_WHY = (
    "Why the two differ: in random folds, pings of the same room, the same session and the same "
    "pose of the sonar stand on both sides. A classifier may then know the room (its furniture's "
    "echoes, its floor, its air, its level) instead of the landmark, and it has met nearly the "
    "same ping before. A robot meets rooms that nobody recorded: leaving out all pings of an "
    "environment asks for that. Where both agree, nothing was to be won by knowing the room: the "
    "pings of a room are then as unlike each other as those of different rooms, or the features "
    "too coarse to know it."
)
_SWEEP_CAPTION = (
    "Each row changes one choice of the default, the environment left out (random folds, if there "
    "is but one). Percent, then the gain over the default in points with its 95 % interval, "
    "paired. Of twenty intervals one leaves zero out by chance."
)


def _about(report: KnownRangeReport) -> str:
    labels = report.labels
    simulated = "simulated " if report.sources == ("sim",) else ""
    skipped = f"; {report.skipped} more have no range and are left out" if report.skipped else ""
    return (
        f"{len(labels.label)} {simulated}pings of {report.folder} in "
        f"{len(set(labels.environment))} environments and {len(set(labels.session))} sessions"
        f"{skipped}; chirp {', '.join(report.chirps)}; manifest {report.manifest_hash[:16]}"
    )


def _percent(one: Accuracy) -> str:
    told = f"{100 * one.mean:.1f}"
    if not math.isnan(one.spread):
        told += f" ± {100 * one.spread:.1f}"
    return told + _bracket(one)


def _points(one: Accuracy) -> str:
    return f"{100 * one.mean:+.1f}" + _bracket(one, "+")


def _bracket(one: Accuracy, sign: str = "") -> str:
    low, high = one.interval
    return "" if math.isnan(low) else f" [{100 * low:{sign}.1f}, {100 * high:{sign}.1f}]"


def _rows(report: KnownRangeReport) -> list[tuple[str, ...]]:
    paper = tuple(f"{mean} ± {spread}" for mean, spread in PAPER_FIGURES.values())
    rows: list[tuple[str, ...]] = [
        ("as printed in the paper", "its own live pings", *paper),
        ("always the commonest", "", *(f"{100 * one:.1f}" for one in report.guesses)),
    ]
    for name, ways in zip(report.methods, report.outcomes, strict=True):
        for way, one in ways.items():
            rows.append((name, _way(way, report), *map(_percent, one.accuracies)))
    return rows


def _way(way: str, report: KnownRangeReport) -> str:
    return f"{report.spec.repeats} x {report.spec.folds} {way}" if way == RANDOM else way


def _differences(report: KnownRangeReport) -> str:
    told = []
    for name, ways in zip(report.methods, report.outcomes, strict=True):
        lost = gain(ways[RANDOM], ways[ENVIRONMENT], TASKS.index("overall"), report.labels)
        told.append(f"{name} {_points(lost)}")
    return (
        "Here, random folds less environment left out, overall, in points: " + "; ".join(told) + "."
    )


def _gains(report: KnownRangeReport, number: int) -> dict[str, tuple[Accuracy, ...]]:
    first, other = report.outcomes[0], report.outcomes[number]
    return {
        way: tuple(gain(other[way], first[way], task, report.labels) for task in range(3))
        for way in first
    }


def _gain_rows(report: KnownRangeReport) -> list[tuple[str, ...]]:
    return [
        (name, way, *map(_points, told))
        for number, name in enumerate(report.methods)
        if number > 0
        for way, told in _gains(report, number).items()
    ]


def _by_environment(report: KnownRangeReport) -> list[tuple[str, ...]]:
    return [
        (group, name, *(f"{100 * v:.1f}" for v in values))
        for group in report.outcomes[0][ENVIRONMENT].by_group
        for name, ways in zip(report.methods, report.outcomes, strict=True)
        for values in [ways[ENVIRONMENT].by_group[group]]
    ]


def _sweep_rows(report: KnownRangeReport) -> list[tuple[str, ...]]:
    head = ("changed", *(f"{name}: {what}" for what in ("%", "gain") for name in HEAD))
    return [
        head,
        *(
            (
                one.change,
                *(f"{100 * accuracy.mean:.1f}" for accuracy in one.outcome.accuracies),
                *map(_points, one.gains),
            )
            for one in report.sweep
        ),
    ]


def _choice_rows(report: KnownRangeReport) -> list[tuple[str, str]]:
    spec = report.spec
    return [
        ("range", "as labelled, +-20 cm: 1024 samples at 450 kHz (given by the paper)"),
        ("band", "30 to 100 kHz (given by the paper)"),
        ("classifier", "linear SVM, one against one (given by the paper)"),
        *((name, str(value)) for name, value in dataclasses.asdict(spec.choices).items()),
        ("random folds", f"{spec.repeats} times {spec.folds}, each label dealt evenly"),
        ("seed", str(spec.seed)),
        ("data manifest", report.manifest_hash),
    ]


def _draw_accuracies(axes: Any, report: KnownRangeReport) -> None:
    ways = list(report.outcomes[0])
    marks = {RANDOM: 0.0, ENVIRONMENT: 1.0, SESSION: 2.0}
    for task, axis in enumerate(axes[0]):
        axis.axhline(100 * report.guesses[task], color="#888", ls=":", lw=1)
        for number, name in enumerate(report.methods):
            told = [report.outcomes[number][way].accuracies[task] for way in ways]
            shift = 0.12 * (number - (len(report.methods) - 1) / 2)
            with_interval(
                axis,
                [marks[way] + shift for way in ways],
                [100 * one.mean for one in told],
                [(100 * one.interval[0], 100 * one.interval[1]) for one in told],
                color=COLOURS[number % len(COLOURS)],
                label=name,
            )
        axis.set(title=HEAD[task], ylim=(0, 102), xlim=(-0.5, 2.5), ylabel="% right")
        axis.set_xticks(
            [marks[way] for way in ways], [way.replace(" ", "\n", 1) for way in ways], fontsize=8
        )
    axes[0][0].legend(loc="lower left", fontsize=8)


def _draw_confusions(axes: Any, ways: dict[str, Outcome], report: KnownRangeReport) -> None:
    sizes = report.labels.classes[:-1]
    for row, (way, one) in enumerate(ways.items()):
        confusion(axes[row][0], one.detection_confusion, ("landmark", "none"), f"present? {way}")
        confusion(axes[row][1], one.size_confusion, sizes, f"which? {way}")


def _outcome_json(one: Outcome, report: KnownRangeReport) -> dict[str, Any]:
    return {
        **_accuracies_json(one.accuracies),
        "detection_confusion": one.detection_confusion.round(3).tolist(),
        "size_confusion": one.size_confusion.round(3).tolist(),
        "overall_confusion": one.overall_confusion.round(3).tolist(),
        "classes": list(report.labels.classes),
        "by_group": {group: [_number(v) for v in values] for group, values in one.by_group.items()},
    }


def _accuracies_json(told: Sequence[Accuracy]) -> dict[str, Any]:
    return {
        task: {
            "mean": _number(one.mean),
            "spread": _number(one.spread),
            "interval": [_number(v) for v in one.interval],
        }
        for task, one in zip(TASKS, told, strict=True)
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 5)
