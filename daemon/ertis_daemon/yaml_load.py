"""YAML text to frozen dataclasses: parsed by the type of the field, every error with its line.

PyYAML's loaders guess a type from the text, and guess wrong in silence: ``4.5e6`` is text to them,
``on`` is true, ``1:30`` is 90, ``010`` is 8, and of two equal keys the last one wins. Here only its
composer is used, which keeps the text, and the dataclass says what the text should be.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

from ertis_driver.errors import ErtisError

MAX_BYTES = 64 * 1024  # a whole configuration is 3 kB; more is a wrong file
MAX_DEPTH = 8  # the deepest one of ours is 3

T = TypeVar("T")
Check = Callable[[Any], "str | None"]

_INT = re.compile(r"[+-]?[0-9]+(_[0-9]+)*")
_FLOAT = re.compile(r"[+-]?([0-9]+(_[0-9]+)*\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_BOOLS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
_NULLS = ("", "~", "null", "Null", "NULL")


class ConfigError(ErtisError):
    """The configuration is wrong: correct the lines named, one error a line."""


def option(
    default: Any,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    check: Check | None = None,
) -> Any:
    """Declare a field of a configuration dataclass.

    Parameters
    ----------
    default
        Its value if the file does not name it.
    doc
        One line for the user, with the unit if the name has none.
    low, high
        Bounds, both allowed values.
    check
        Says what is wrong with a value, or None.
    """
    meta = {"doc": doc, "low": low, "high": high, "check": check}
    return field(default=default, metadata=meta)


def section(kind: type[T], doc: str) -> T:
    """Declare a nested section, all of whose fields have defaults."""
    made: Any = field(default_factory=kind, metadata={"doc": doc})
    return made  # type: ignore[no-any-return]


@dataclass(slots=True)
class Marks:
    """Where each key stands and what was wrong; ``path`` is dotted, empty for the whole file."""

    name: str
    errors: list[tuple[int, int, str]] = field(default_factory=list)
    places: dict[str, tuple[int, int]] = field(default_factory=dict)

    def add(self, path: str, message: str, place: tuple[int, int] | None = None) -> None:
        """Note an error at ``place``, or where ``path`` or the section around it stands."""
        outer = path
        while place is None:
            place = self.places.get(outer) or (None if outer else (1, 1))
            outer = outer.rpartition(".")[0]
        self.errors.append((*place, f"{path}: {message}" if path else message))

    def raise_errors(self) -> None:
        """Raise all errors at once, in the order of their lines.

        Raises
        ------
        ConfigError
            If there are any.
        """
        if self.errors:
            lines = (f"{self.name}:{line}:{col}: {text}" for line, col, text in sorted(self.errors))
            raise ConfigError("\n".join(lines))


class _Composer(yaml.SafeLoader):
    """Composes nodes; refuses what a configuration needs not and a parser suffers from."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        mark = event.start_mark
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases are not allowed", problem_mark=mark)
        if getattr(event, "tag", None) is not None:
            raise yaml.MarkedYAMLError(problem="tags are not allowed", problem_mark=mark)
        self.depth += 1
        if self.depth > MAX_DEPTH:
            problem = f"nested deeper than {MAX_DEPTH} levels"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def load(kind: type[T], data: bytes, marks: Marks) -> T:
    """Read one dataclass from YAML; what is wrong goes into ``marks``, its default is used.

    Raises
    ------
    ConfigError
        If the text is no YAML at all, too large or too deep.
    """
    node = _compose(data, marks)
    if node is None:
        return kind()
    value: T = _section(kind, node, "", marks)
    return value


def _compose(data: bytes, marks: Marks) -> yaml.Node | None:
    try:
        if len(data) > MAX_BYTES:
            raise ConfigError(f"{marks.name}: larger than {MAX_BYTES} bytes, is it the right file?")
        return yaml.compose(data.decode("utf-8-sig"), Loader=_Composer)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        raise ConfigError(f"{marks.name}:{place}: {error.problem or error.context}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{marks.name}:1:1: not UTF-8 YAML text: {reason}") from error


def _place(node: yaml.Node) -> tuple[int, int]:
    return node.start_mark.line + 1, node.start_mark.column + 1


def _is_null(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and not node.style and node.value in _NULLS


def _section(kind: type, node: yaml.Node, path: str, marks: Marks) -> Any:
    if _is_null(node):  # all of its lines are comments
        return kind()
    if not isinstance(node, yaml.MappingNode):
        marks.add(path, "expected 'key: value' lines", _place(node))
        return kind()
    hints = get_type_hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = key_node.value if isinstance(key_node, yaml.ScalarNode) else "?"
        where = f"{path}.{key}" if path else key
        if key not in fields:
            marks.add(where, _unknown(key, list(fields)), _place(key_node))
        elif where in marks.places:
            first = marks.places[where][0]
            marks.add(where, f"given twice, first in line {first}", _place(key_node))
        else:
            marks.places[where] = _place(key_node)
            try:
                values[key] = _value(hints[key], fields[key], value_node, where, marks)
            except ValueError as error:
                marks.add(where, str(error), _place(value_node))
    return kind(**values)


def _unknown(key: str, known: list[str]) -> str:
    near = difflib.get_close_matches(key, known, n=1)
    if near:
        return f"unknown key, did you mean '{near[0]}'?"
    return f"unknown key, expected one of {', '.join(known)}"


def _value(
    hint: Any, spec: dataclasses.Field[Any], node: yaml.Node, path: str, marks: Marks
) -> Any:
    if dataclasses.is_dataclass(hint):
        assert isinstance(hint, type)
        return _section(hint, node, path, marks)
    value = _sequence(hint, node) if get_origin(hint) is tuple else _scalar(hint, node)
    low, high = spec.metadata["low"], spec.metadata["high"]
    if (low is not None and value < low) or (high is not None and value > high):
        ends = f"{low:g} or more" if high is None else f"{low:g} to {high:g}"
        raise ValueError(f"{value}, expected {ends}")
    check = spec.metadata["check"]
    problem = check(value) if check else None
    if problem:
        raise ValueError(problem)
    return value


def _sequence(hint: Any, node: yaml.Node) -> tuple[Any, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise ValueError("expected a list, for example [a, b] or []")
    return tuple(_scalar(get_args(hint)[0], item) for item in node.value)


def _scalar(hint: Any, node: yaml.Node) -> Any:
    if not isinstance(node, yaml.ScalarNode):
        raise ValueError("expected one value, found a list or section")
    text = str(node.value)
    if _is_null(node):
        raise ValueError(
            "no value; leave the key out for its default"
            + (", or write '' for none" if hint is str else "")
        )
    if get_origin(hint) is Literal:
        if text not in get_args(hint):
            raise ValueError(f"{text!r}, expected one of {', '.join(get_args(hint))}")
        return text
    return text if hint is str else _PARSERS[hint](text)


def _parse_bool(text: str) -> bool:
    if text.lower() not in _BOOLS:
        raise ValueError(f"{text!r}, expected true or false")
    return _BOOLS[text.lower()]


def _parse_int(text: str) -> int:
    if not _INT.fullmatch(text):
        raise ValueError(f"{text!r}, expected a whole number")
    _refuse_octal(text)
    return int(text)


def _parse_float(text: str) -> float:
    if not _FLOAT.fullmatch(text) or not math.isfinite(float(text)):
        raise ValueError(f"{text!r}, expected a finite number")
    _refuse_octal(text)
    return float(text)


def _refuse_octal(text: str) -> None:
    if re.match(r"[+-]?0[0-9_]", text):
        raise ValueError(f"{text!r} is octal to some and decimal to others: drop the leading 0")


_PARSERS: types.MappingProxyType[Any, Callable[[str], Any]] = types.MappingProxyType(
    {bool: _parse_bool, int: _parse_int, float: _parse_float}
)
