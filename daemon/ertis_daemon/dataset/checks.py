"""``ertis dataset check``: everything that can be wrong with a data set, found."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from ertis_daemon.dataset.finding import Finding
from ertis_daemon.dataset.heard import Heard
from ertis_daemon.dataset.journal import Journal
from ertis_daemon.dataset.judge import CLIPPED, MICROPHONES, SILENT, WEAK
from ertis_daemon.dataset.label import LABELS
from ertis_driver.dataset import NONE, PART, DatasetRow
from ertis_driver.dataset_table import Table

BALANCE = 2.0  # a class this many times rarer than the median is told
# Before that no clock ran: simulated recordings count from the epoch.
CLOCK_FROM_NS = 10**18
SONAR_KINDS = (MICROPHONES, CLIPPED, SILENT)


def check_table(folder: Path, table: Table) -> list[Finding]:
    """Look at the table alone, and at which files there are."""
    found = [Finding("table", one.text, one.file_name, one.line) for one in table.problems]
    known = {row.file_name for row in table.rows} | {one.file_name for one in table.problems}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name.endswith(PART):
            text = "was not finished: remove it, or resume with `ertis dataset record`"
            found.append(Finding("unfinished", text, name))
        elif name.endswith(".mcap") and name not in known:
            text = "is not in the table: resume with `ertis dataset record`, or remove it"
            found.append(Finding("stray", text, name))
    for row in table.rows:
        found += _of_row(row)
    return found + _balance(table.rows) + _mixed_folders(table.rows)


def check_heard(folder: Path, rows: Sequence[DatasetRow], heard: Sequence[Heard]) -> list[Finding]:
    """Look at what the recordings hold; ``heard`` has one entry a row."""
    relabelled = Journal(folder).relabelled()
    found = []
    good = []
    for row, what in zip(rows, heard, strict=True):
        if what.problem:
            found.append(Finding(what.problem_kind, what.problem, row.file_name, row.line))
        if what.words_sha256:
            good.append((row, what))
            found += _label_and_echo(row, what, row.file_name in relabelled)
    return found + _of_sonar(good) + _duplicates(good) + _overlaps(good) + _mixed_settings(good)


def _of_row(row: DatasetRow) -> list[Finding]:
    texts = []
    if not row.sha256:
        texts.append(("hash", "no sha256 in the table: nobody would see that the file changed"))
    if row.label not in LABELS:
        texts.append(("label", f"label {row.label!r}, expected one of {', '.join(LABELS)}"))
    elif row.label != NONE and row.range_m != row.range_m:
        texts.append(("label", f"{row.label} without range_m: nobody knows which echo it is"))
    if not row.environment:
        texts.append(("leak", "no environment: it cannot be left out in an evaluation"))
    return [Finding(kind, text, row.file_name, row.line) for kind, text in texts]


def _label_and_echo(row: DatasetRow, what: Heard, is_relabelled: bool) -> list[Finding]:
    found = []
    # What the table says is weak, or hidden, is known to be so.
    if WEAK in what.notes and not {WEAK, "shadowed"} & set(row.quality.split()):
        found.append(Finding("echo", what.notes[WEAK], row.file_name, row.line))
    if what.recorded_label and what.recorded_label != row.label and not is_relabelled:
        text = (
            f"label {row.label}, but recorded as {what.recorded_label}: correct it, or say that it "
            "is meant with `ertis dataset relabel`"
        )
        found.append(Finding("label", text, row.file_name, row.line))
    return found


def _of_sonar(good: Sequence[tuple[DatasetRow, Heard]]) -> list[Finding]:
    """What is wrong with the sonar is so for many pings: one finding a session."""
    counts: Counter[tuple[str, str, str, str]] = Counter()
    pings: Counter[tuple[str, str]] = Counter()
    for row, what in good:
        pings[row.environment, row.session] += 1
        for kind in SONAR_KINDS:
            if kind in what.notes and kind not in row.quality.split():
                counts[row.environment, row.session, kind, what.notes[kind]] += 1
    return [
        Finding(
            kind,
            f"{environment}/{session}, {count} of {pings[environment, session]} pings: {text}",
        )
        for (environment, session, kind, text), count in sorted(counts.items())
    ]


def _duplicates(good: Sequence[tuple[DatasetRow, Heard]]) -> list[Finding]:
    same: dict[str, list[DatasetRow]] = defaultdict(list)
    for row, what in good:
        same[what.words_sha256].append(row)
    found = []
    for first, *others in same.values():
        for row in others:
            text = f"the same ping as {first.file_name}: keep one of them"
            kind = "duplicate"
            if row.environment != first.environment:
                kind = "leak"
                text += f"; it stands in {first.environment} and {row.environment}"
            if row.label != first.label:
                text += f"; labelled {first.label} there and {row.label} here"
            found.append(Finding(kind, text, row.file_name, row.line))
    return found


def _mixed_folders(rows: Iterable[DatasetRow]) -> list[Finding]:
    """One session's folder is one place: rows of it in two environments are a leak."""
    folders: dict[str, Counter[tuple[str, str]]] = defaultdict(Counter)
    rows = list(rows)
    for row in rows:
        folders[row.file_name.rpartition("/")[0]][row.environment, row.session] += 1
    found = []
    for row in rows:
        folder = row.file_name.rpartition("/")[0]
        (environment, session), _ = folders[folder].most_common(1)[0]
        if row.environment != environment:
            text = (
                f"environment {row.environment!r}, but others of folder {folder} have "
                f"{environment!r}: one session in two environments"
            )
            found.append(Finding("leak", text, row.file_name, row.line))
        elif row.session != session:
            text = f"session {row.session!r}, but others of folder {folder} have {session!r}"
            found.append(Finding("leak", text, row.file_name, row.line))
    return found


def _overlaps(good: Sequence[tuple[DatasetRow, Heard]]) -> list[Finding]:
    """Two environments recorded through each other in time: one run that was split."""
    times: dict[tuple[str, str], list[int]] = defaultdict(list)
    for row, what in good:
        if what.ping_time_ns >= CLOCK_FROM_NS:
            times[row.environment, row.session].append(what.ping_time_ns)
    spans = sorted((min(all_of), max(all_of), group) for group, all_of in times.items())
    found = []
    for at, (_, end, group) in enumerate(spans):
        for start, _, other in spans[at + 1 :]:
            if start > end:
                break
            if other[0] != group[0]:
                text = (
                    f"{'/'.join(group)} and {'/'.join(other)} were recorded at the same time: one "
                    "session in two environments"
                )
                found.append(Finding("leak", text))
    return found


def _mixed_settings(good: Sequence[tuple[DatasetRow, Heard]]) -> list[Finding]:
    found = []
    settings = Counter(what.settings for _, what in good)
    sources = Counter(what.source for _, what in good)
    for kind, name, counts in (("settings", "settings", settings), ("source", "sources", sources)):
        if len(counts) > 1:
            each = ", ".join(f"{count} with {value}" for value, count in counts.most_common())
            found.append(Finding(kind, f"several {name} in one data set: {each}"))
    return found


def _balance(rows: Sequence[DatasetRow]) -> list[Finding]:
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for row in rows:
        counts[row.environment][row.label] += 1
    labels = sorted({row.label for row in rows})
    found = []
    for environment, of_labels in sorted(counts.items()):
        numbers = sorted(of_labels[label] for label in labels)
        usual = numbers[len(numbers) // 2]
        for label in labels:
            if of_labels[label] * BALANCE < usual:
                text = f"{environment}: {of_labels[label]} of {label}, others {usual}: record more"
                found.append(Finding("balance", text))
    return found
