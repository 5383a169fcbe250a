"""The talk with whoever records a data set: lines in, lines out, at a terminal or from a pipe."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from difflib import get_close_matches

from ertis_daemon.dataset.label import FOLDER_NAME, LABELS, Label, Place, is_folder_name
from ertis_driver.dataset import NONE
from ertis_driver.dataset_table import angle_text, parse_angle_rad, parse_range_m, range_text

HELP = """\
Enter      ping, with what is shown
r48        another label: r35 r48 r58 r70 none, or l NAME
r 3.2      range, m, to the dish's vertex (or to where one would be)
b -10      bearing, degrees, + left
t 30       turn of the dish away from the sonar, degrees, + left
r 2 t 0 p  several at once; p pings
u          undo the last ping
e          another environment or session
q          end
Without a value, r, b and t forget theirs."""
_NUMBERS = ("r", "b", "t")
_WORDS = ("p", "u", "e", "q", "?")
_MIN_TEMPERATURE_C, _MAX_TEMPERATURE_C = -60.0, 80.0

Ask = Callable[[str], str | None]  # a prompt to an answer; None when there are no more
Say = Callable[[str], None]


class EndOfAnswers(Exception):  # no error: whoever answers has gone
    """Nobody answers any more."""


class Dialog:
    """Asks for what a label needs, and keeps what was said last.

    Parameters
    ----------
    ask, say
        The terminal, or a pipe.
    """

    def __init__(self, ask: Ask, say: Say) -> None:
        self._ask, self._say = ask, say

    def place(self, before: Place | None, next_session: Callable[[str], str]) -> Place:
        """Ask where this is; an empty answer keeps what was before.

        Raises
        ------
        EndOfAnswers
        """
        known = before or Place("", "", "", 20.0)
        environment = self._name("environment", known.environment)
        same = environment == known.environment and known.session
        session = self._name("session", known.session if same else next_session(environment))
        operator = self._answer("operator", known.operator)
        return Place(environment, session, operator, self._temperature(known.temperature_c))

    def label(self, before: Label | None) -> Label:
        """Ask for the first label; an empty answer keeps what was before, ``-`` forgets it.

        Raises
        ------
        EndOfAnswers
        """
        known = before or Label("")
        while True:
            name = self._answer(f"label ({' '.join(LABELS)})", known.label)
            if is_folder_name(name):
                break
            self._say("a label such as r48, or none")
        to = "where one would be" if name == NONE else "to the vertex"
        needed = name != NONE
        range_m = self._number(f"range, m ({to})", parse_range_m, range_text, known.range_m, needed)
        azimuth = self._angle("bearing, degrees (+ left)", known.azimuth_rad)
        if name == NONE:
            return Label(name, range_m, azimuth)
        yaw = self._angle("turn of the dish, degrees (+ left)", known.yaw_rad)
        return Label(name, range_m, azimuth, yaw)

    def line(self, prompt: str) -> str:
        """Ask for the next words.

        Raises
        ------
        EndOfAnswers
        """
        answer = self._ask(prompt)
        if answer is None:
            raise EndOfAnswers
        return answer.strip()

    def _answer(self, name: str, before: str) -> str:
        return self.line(f"{name} [{before}]: " if before else f"{name}: ") or before

    def _name(self, name: str, before: str) -> str:
        while True:
            answer = self._answer(name, before)
            if is_folder_name(answer):
                return answer
            self._say(f"{name} {answer!r}, expected {FOLDER_NAME}")

    def _temperature(self, before: float) -> float:
        while True:
            answer = self._answer("air, degrees C", f"{before:g}")
            try:
                value = float(answer)
            except ValueError:
                value = math.nan
            if _MIN_TEMPERATURE_C <= value <= _MAX_TEMPERATURE_C:
                return value
            self._say(f"{answer!r}, expected {_MIN_TEMPERATURE_C:g} to {_MAX_TEMPERATURE_C:g}")

    def _angle(self, name: str, before_rad: float) -> float:
        return self._number(name, parse_angle_rad, angle_text, before_rad, needed=False)

    def _number(
        self,
        name: str,
        parse: Callable[[str], float],
        show: Callable[[float], str],
        before: float,
        needed: bool,
    ) -> float:
        shown = show(before)
        hint = shown or ("" if needed else "not known")
        while True:
            answer = self._answer(name, hint)
            if answer in (hint, "-"):
                answer = shown if answer == hint else ""
            try:
                value = parse(answer)
            except ValueError as error:
                self._say(f"{answer!r}, expected {error}")
                continue
            if not needed or not math.isnan(value):
                return value
            self._say("a landmark's range must be known")


@dataclasses.dataclass(frozen=True, slots=True)
class Command:
    """What one line asks for.

    label : Label
        After it.
    deed : str
        ``p`` ping, ``u`` undo, ``e`` elsewhere, ``q`` quit, ``?`` help; empty: nothing.
    """

    label: Label
    deed: str


def parse_line(line: str, label: Label) -> Command:
    """Read a line of words.

    Raises
    ------
    ValueError
        What was not understood; nothing of the line counts then.
    """
    words = line.split()
    if not words:
        return Command(label, "p")
    deed = ""
    while words:
        word = words.pop(0)
        if word in _NUMBERS:
            parse = parse_range_m if word == "r" else parse_angle_rad
            text = words.pop(0) if words and _is_value(words[0]) else ""
            try:
                value = parse(text)
            except ValueError as error:
                raise ValueError(f"{word} {text}: expected {error}") from None
            label = _with(label, word, value)
        elif word in _WORDS:
            if deed or (words and word != "?"):
                raise ValueError(f"{word} comes last, and alone of p, u, e, q and ?")
            deed = word
        elif word == "l" or word in LABELS:
            name = word if word != "l" else (words.pop(0) if words else "")
            if not is_folder_name(name):
                raise ValueError(f"label {name!r}, expected letters, digits, - _ .")
            yaw = math.nan if name == NONE else label.yaw_rad
            label = dataclasses.replace(label, label=name, yaw_rad=yaw)
        else:
            near = get_close_matches(word, [*LABELS, *_WORDS, *_NUMBERS], 1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise ValueError(f"{word!r} is not understood: {hint}? lists the words")
    if deed == "p" and label.label != NONE and math.isnan(label.range_m):
        raise ValueError(f"the range of {label.label} must be known: r 3.2")
    return Command(label, deed)


def _is_value(word: str) -> bool:
    return word not in _NUMBERS and word not in _WORDS and word != "l" and word not in LABELS


def _with(label: Label, word: str, value: float) -> Label:
    if word == "r":
        return dataclasses.replace(label, range_m=value)
    if word == "b":
        return dataclasses.replace(label, azimuth_rad=value)
    return dataclasses.replace(label, yaw_rad=value)
