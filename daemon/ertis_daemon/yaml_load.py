"""YAML nodes to frozen dataclasses: parsed by the type of the field, every error with its line.

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
from dataclasses import field
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

from ertis_daemon.yaml_nodes import Marks, is_null, key_name, place_of

T = TypeVar("T")
Check = Callable[[Any], "str | None"]

_INT = re.compile(r"[+-]?[0-9]+(_[0-9]+)*")
_FLOAT = re.compile(r"[+-]?([0-9]+(_[0-9]+)*\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_BOOLS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


def option(
    default: Any,
    doc: str,
    *,
    low: float | None = None,
    high: float | None = None,
    check: Check | None = None,
    own: str = "",
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
    own
        Its default for one of several named sections, ``{name}`` in it; there it is never that of
        the section around them.
    """
    meta = {"doc": doc, "low": low, "high": high, "check": check, "own": own}
    return field(default=default, metadata=meta)


def section(kind: type[T], doc: str) -> T:
    """Declare a nested section, all of whose fields have defaults."""
    made: Any = field(default_factory=kind, metadata={"doc": doc})
    return made  # type: ignore[no-any-return]


def load(kind: type[T], node: yaml.Node | None, marks: Marks, path: str = "") -> T:
    """Read one dataclass; what is wrong goes into ``marks``, its default is used.

    Parameters
    ----------
    node
        None for all defaults.
    path
        Dotted, in front of the keys in messages.
    """
    if node is None:
        return kind()
    value: T = _section(kind, node, path, marks)
    return value


def _section(kind: type, node: yaml.Node, path: str, marks: Marks) -> Any:
    if is_null(node):  # all of its lines are comments
        return kind()
    if not isinstance(node, yaml.MappingNode):
        marks.add(path, "expected 'key: value' lines", place_of(node))
        return kind()
    hints = get_type_hints(kind)
    fields = {f.name: f for f in dataclasses.fields(kind)}
    values: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = key_name(key_node)
        where = f"{path}.{key}" if path else key
        if key not in fields:
            marks.add(where, _unknown(key, list(fields)), place_of(key_node))
        else:
            marks.places[where] = place_of(key_node)
            try:
                values[key] = _value(hints[key], fields[key], value_node, where, marks)
            except ValueError as error:
                marks.add(where, str(error), place_of(value_node))
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
    if is_null(node):
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
