"""One run of ``ertis dataset record``: dialog, sonar, judge and recorder together."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ertis_daemon.dataset.dialog import HELP, Dialog, EndOfAnswers, parse_line
from ertis_daemon.dataset.judge import GOOD, Judge, Judgement
from ertis_daemon.dataset.label import Label, Place
from ertis_daemon.dataset.recorder import DatasetRecorder
from ertis_driver.dataset import DatasetRow
from ertis_driver.device import Sonar
from ertis_driver.errors import DeviceError, DeviceLost, EndOfRecording, NotConfigured
from ertis_driver.recording import RecordingInfo


@dataclass(slots=True)
class Tally:
    """What a run did."""

    recorded: int = 0
    undone: int = 0
    failed: int = 0
    doubtful: set[str] = field(default_factory=set)


class Session:
    """Records pings as long as somebody answers.

    Parameters
    ----------
    recorder
        The data set.
    sonar
        Configured.
    dialog, say
        Whoever answers, and where messages go.
    show
        Called with what is to be told of each ping taken in.

    Raises
    ------
    NotConfigured
    """

    def __init__(
        self,
        recorder: DatasetRecorder,
        sonar: Sonar,
        dialog: Dialog,
        say: Callable[[str], None],
        show: Callable[[DatasetRow, Judgement], None],
    ) -> None:
        self._recorder, self._sonar = recorder, sonar
        self._dialog, self._say, self._show = dialog, say, show
        if sonar.settings is None:
            raise NotConfigured("the sonar has no settings: call configure first")
        self._settings = sonar.settings  # a recording that is replayed has its own
        self._judge = Judge(self._settings.chirp, self._settings.num_words)
        self.tally = Tally()

    def run(self) -> Tally:
        """Ask and ping until ``q`` or the end of the answers.

        Raises
        ------
        DeviceLost
            If the sonar went away for good.
        DatasetError, RecordingError
            If the disk does not take a ping.
        """
        try:
            place = self._place(self._recorder.last_place())
            label = self._dialog.label(self._recorder.last_label())
            self._say("Enter pings, ? lists the other words")
            while True:
                number = self._recorder.next_number(place)
                where = f"{place.environment}/{place.session}/{number:04d}"
                line = self._dialog.line(f"{where} {label} > ")
                try:
                    command = parse_line(line, label)
                except ValueError as error:
                    self._say(str(error))
                    continue
                label = command.label
                if command.deed == "q":
                    break
                if command.deed == "p":
                    self._ping(label, place)
                elif command.deed == "u":
                    self._undo()
                elif command.deed == "e":
                    place = self._place(place)
                elif command.deed == "?":
                    self._say(HELP)
        except EndOfAnswers:
            pass
        except EndOfRecording as error:
            self._say(str(error))
        return self.tally

    def _place(self, before: Place | None) -> Place:
        return self._dialog.place(before, self._recorder.next_session)

    def _ping(self, label: Label, place: Place) -> None:
        try:
            frame = self._sonar.ping()
        except DeviceLost:
            raise
        except DeviceError as error:
            self.tally.failed += 1
            self._say(f"no ping: {error}")
            return
        judgement = self._judge.judge(frame, label, place.temperature_c)
        about = self._sonar.info
        info = RecordingInfo(
            about.source,
            self._settings.chirp,
            self._settings.num_words,
            place.temperature_c,
            firmware=about.firmware,
            address=about.address,
            operator=place.operator,
            place=f"{place.environment}/{place.session}",
        )
        row = self._recorder.add(frame, label, place, info, judgement.quality)
        self.tally.recorded += 1
        if judgement.quality != GOOD:
            self.tally.doubtful.add(row.file_name)
        self._show(row, judgement)
        for note in judgement.notes.values():
            self._say(f"! {note}; u undoes")

    def _undo(self) -> None:
        row = self._recorder.undo()
        if row is None:
            self._say("nothing to undo")
            return
        self.tally.undone += 1
        self.tally.doubtful.discard(row.file_name)
        self._say(f"undone: {row.file_name}")


def as_json(row: DatasetRow, judgement: Judgement) -> dict[str, Any]:
    """What is told of a ping taken in."""
    return {
        **row.values(),
        "echo_db": None if math.isnan(judgement.echo_db) else judgement.echo_db,
        "dead_microphones": [channel.row for channel in judgement.dead_microphones],
        "notes": list(judgement.notes.values()),
    }


def as_text(row: DatasetRow, judgement: Judgement) -> str:
    """Return the same as a line."""
    echo = "" if math.isnan(judgement.echo_db) else f": echo {judgement.echo_db:.0f} dB"
    label = Label(row.label, row.range_m, row.azimuth_rad, row.yaw_rad)
    return f"{row.file_name}  {label}{echo}, {judgement.quality}"
