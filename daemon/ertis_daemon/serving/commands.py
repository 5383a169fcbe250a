"""What ``cmd/...`` of one sonar may ask for, and what it is answered."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from ertis_daemon.queries import CommandError
from ertis_daemon.recording.recorder import LONGEST_S
from ertis_daemon.serving.life import SonarLife


class Commands:
    """Obeys the commands for one sonar: ``ping``, ``record``, ``reload``.

    Parameters
    ----------
    life
        Gives the sonar, which may not be there yet.
    reload
        Reads the configuration again and says what came of it, one text a line.
    """

    def __init__(
        self, life: Callable[[], SonarLife | None], reload: Callable[[], Sequence[str]]
    ) -> None:
        self._life = life
        self._reload = reload

    def __call__(self, name: str, parameters: Mapping[str, str]) -> Mapping[str, Any]:
        """Do it.

        Raises
        ------
        CommandError
            If it or a parameter of it makes no sense now.
        ErtisError
            If it failed.
        """
        if name == "reload":
            _check(parameters, ())
            return {"said": list(self._reload())}
        life = self._life()
        if life is None:
            raise CommandError("the sonar is being set up: ask again")
        return self._ping(life, parameters) if name == "ping" else self._record(life, parameters)

    def _ping(self, life: SonarLife, parameters: Mapping[str, str]) -> Mapping[str, Any]:
        _check(parameters, ("count",))
        if life.config.ping_on != "command":
            raise CommandError(f"pings on {life.config.ping_on}, not on command: set ping_on")
        count = int(_number(parameters, "count", 1, 1, 100))
        return {"waiting": life.requests.ask(count)}

    def _record(self, life: SonarLife, parameters: Mapping[str, str]) -> Mapping[str, Any]:
        _check(parameters, ("before_s", "after_s"))
        config = life.config.record
        before_s = _number(parameters, "before_s", config.before_s, 0, config.before_s)
        after_s = _number(parameters, "after_s", config.after_s, 0, LONGEST_S)
        return {"path": str(life.recorder.trigger("on-demand", before_s, after_s))}


def _check(parameters: Mapping[str, str], known: tuple[str, ...]) -> None:
    for name in parameters:
        if name not in known:
            expected = ", ".join(known) or "none"
            raise CommandError(f"unknown parameter {name!r}, expected {expected}")


def _number(
    parameters: Mapping[str, str], name: str, default: float, low: float, high: float
) -> float:
    text = parameters.get(name)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise CommandError(f"{name} {text!r}, expected {low:g} to {high:g}")
    return value
