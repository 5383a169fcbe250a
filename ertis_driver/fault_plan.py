"""Which fault happens to which message: named one by one, or drawn from a seed."""

from __future__ import annotations

import difflib
import logging
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields
from typing import Literal, Protocol

import numpy as np

from ertis_driver.errors import SettingsError
from ertis_driver.faults import FAULTS, Device, Fault, Late
from ertis_driver.outbox import Step
from ertis_driver.protocol import REPLY_BYTES

log = logging.getLogger(__name__)

Unit = Literal["frame", "reply"]

EXAMPLE = "drop@frame=3,byte=1000,count=7"
# Those that end by themselves, and with bounds a bored user can wait for.
DRAWN_KINDS = ("drop", "double", "insert", "flip", "magic", "stall", "silent", "jump", "late")
MAX_DRAWN_COUNT = 4096
MAX_DRAWN_S = 2.0


class FaultPlan(Protocol):
    """Says what goes wrong."""

    def pick(self, unit: Unit, number: int, size: int) -> Fault | None:
        """Return the fault of the ``number``-th frame or reply (from 0), ``size`` bytes long."""


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault and the message that it happens to.

    unit : str
        ``frame`` or ``reply``.
    number : int
        Which of them, from 0, since the emulator started.
    """

    fault: Fault
    unit: Unit
    number: int

    def __str__(self) -> str:
        """As ``parse_fault`` reads it."""
        values = {field.name: getattr(self.fault, field.name) for field in fields(self.fault)}
        where = {self.unit: self.number, **values}
        return f"{self.fault.kind}@" + ",".join(f"{key}={value}" for key, value in where.items())


class NamedFaults:
    """Faults that were named one by one; implements ``FaultPlan``."""

    def __init__(self, planned: Iterable[PlannedFault]) -> None:
        self._faults = {(entry.unit, entry.number): entry.fault for entry in planned}

    def pick(self, unit: Unit, number: int, size: int) -> Fault | None:
        """Return the fault named for this message."""
        return self._faults.get((unit, number))


class DrawnFaults:
    """Faults at random, the same for the same seed; implements ``FaultPlan``.

    Parameters
    ----------
    seed
        Each message has a generator of its own, made from this and its number: what happens to
        one does not depend on what was asked before.
    rate
        Which share of the frames is hit, 0 to 1.
    kinds
        What to draw from.

    Raises
    ------
    SettingsError
        If the rate is no share, or a kind is unknown.
    """

    def __init__(self, seed: int, rate: float, kinds: Collection[str] = DRAWN_KINDS) -> None:
        if not 0.0 <= rate <= 1.0:
            raise SettingsError(f"fault rate {rate:g}, expected 0 to 1")
        if seed < 0:
            raise SettingsError(f"fault seed {seed}, expected 0 or more")
        self._seed = seed
        self._rate = rate
        self._kinds = [fault_class(kind).kind for kind in kinds]

    def pick(self, unit: Unit, number: int, size: int) -> Fault | None:
        """Return the fault drawn for this frame, if any. Replies are left alone."""
        if unit != "frame":
            return None
        rng = np.random.default_rng([self._seed, number])
        if rng.random() >= self._rate:
            return None
        return draw_fault(rng, str(rng.choice(self._kinds)), size)


class FaultInjector:
    """Applies a plan to messages as they leave the device.

    Parameters
    ----------
    plan
        None leaves every message as it is.
    device
        What a reset resets.

    Attributes
    ----------
    injected : deque of PlannedFault
        The last 1000.
    """

    def __init__(self, plan: FaultPlan | None, device: Device) -> None:
        self._plan = plan
        self._device = device
        self._counts: dict[Unit, int] = {"frame": 0, "reply": 0}
        self._late: list[Step] = []
        self._late_for_frame = False
        self.injected: deque[PlannedFault] = deque(maxlen=1000)

    @property
    def num_replies(self) -> int:
        """Replies that came by, frames not counted."""
        return self._counts["reply"]

    def inject(self, message: bytes) -> list[Step]:
        """What is sent when the device wants to send ``message``, a reply or a frame."""
        unit: Unit = "reply" if len(message) == REPLY_BYTES else "frame"
        number = self._counts[unit]
        self._counts[unit] = number + 1
        late: list[Step] = []
        if unit == "frame" or not self._late_for_frame:
            late, self._late = self._late, []
        fault = self._plan.pick(unit, number, len(message)) if self._plan else None
        if fault is None:
            return [*late, message]
        planned = PlannedFault(fault, unit, number)
        self.injected.append(planned)
        log.warning("fault %s", planned)
        if isinstance(fault, Late):
            self._late.append(message)
            self._late_for_frame = bool(fault.past_replies)
        return [*late, *fault.steps(message, self._device)]


def draw_fault(rng: np.random.Generator, kind: str, size: int) -> Fault:
    """Draw the parameters of a fault to a message of ``size`` bytes."""
    made = fault_class(kind)
    drawn: dict[str, int | float] = {"byte": int(rng.integers(0, size))}
    for field in fields(made):
        if field.name == "count":
            # Small ones are the likelier: what is lost is a byte, a word, a packet.
            drawn["count"] = int(np.exp(rng.uniform(0.0, np.log(min(size, MAX_DRAWN_COUNT)))))
        elif field.name == "mask":
            drawn["mask"] = int(rng.integers(1, 256))
        elif field.name in ("footer", "past_replies"):
            drawn[field.name] = int(rng.integers(0, 2))
        elif field.name in ("word", "seed"):
            drawn[field.name] = int(rng.integers(0, 2**32))
        elif field.name in ("seconds", "away"):
            drawn[field.name] = round(float(rng.uniform(0.0, MAX_DRAWN_S)), 3)
        elif field.name == "by":
            drawn["by"] = int(rng.integers(1, 1000))
    return made(**drawn)  # type: ignore[arg-type]


def parse_fault(text: str) -> PlannedFault:
    """Read ``kind@frame=N,key=value,...``, or ``reply`` instead of ``frame``; N counts from 0.

    >>> parse_fault("drop@frame=3,byte=1000,count=7").fault
    Drop(byte=1000, count=7)

    Raises
    ------
    SettingsError
        If it is malformed, or a kind or key is unknown; names the nearest known one.
    """
    kind, at, rest = text.partition("@")
    made = fault_class(kind.strip())
    if not at:
        raise SettingsError(f"fault {text!r} does not say to what it happens, expected {EXAMPLE}")
    types = {field.name: float if field.type == "float" else int for field in fields(made)}
    values: dict[str, float] = {}
    for part in rest.split(","):
        key, equals, value = (word.strip() for word in part.partition("="))
        if key not in {"frame", "reply", *types}:
            known = ["frame", "reply", *types]
            raise SettingsError(f"fault {text!r}: {key!r}, expected {_nearest(key, known)}")
        try:
            values[key] = types.get(key, int)(value)
        except ValueError:
            raise SettingsError(
                f"fault {text!r}: {key}{equals}{value}, expected a number, as in {EXAMPLE}"
            ) from None
    units: list[Unit] = [unit for unit in ("frame", "reply") if unit in values]
    if len(units) != 1 or values[units[0]] < 0:
        raise SettingsError(f"fault {text!r}, expected one of frame=N and reply=N, as in {EXAMPLE}")
    number = int(values.pop(units[0]))
    return PlannedFault(made(**values), units[0], number)  # type: ignore[arg-type]


def fault_class(kind: str) -> type[Fault]:
    """Look up a kind of fault.

    Raises
    ------
    SettingsError
        If there is none of that name; names the nearest one.
    """
    if kind not in FAULTS:
        raise SettingsError(f"fault {kind!r} is unknown, expected {_nearest(kind, list(FAULTS))}")
    return FAULTS[kind]


def _nearest(word: str, known: list[str]) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f"{near[0]}?" if near else f"one of {', '.join(known)}"
