"""A configuration as commented YAML that reads back equal."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any


def write_yaml(node: Any) -> str:
    """Write a configuration dataclass, each key with what it means above it."""
    return "\n".join(_lines(node, "")) + "\n"


def _lines(node: Any, indent: str) -> list[str]:
    lines = []
    for spec in dataclasses.fields(node):
        value = getattr(node, spec.name)
        lines += [f"{indent}# {line}" for line in spec.metadata["doc"].splitlines()]
        if dataclasses.is_dataclass(value):
            lines += [f"{indent}{spec.name}:", *_lines(value, indent + "  "), ""]
        elif isinstance(value, Mapping) and value:
            lines += [f"{indent}{spec.name}:", *_named_lines(node, value, indent + "  ")]
        else:
            lines.append(f"{indent}{spec.name}: {_text(value)}")
    return lines


def _named_lines(node: Any, named: Mapping[str, Any], indent: str) -> list[str]:
    """The members of a mapping: of each, only what differs from the section around them."""
    lines = []
    for name, value in named.items():
        differing = _differing(value, node, indent + "  ", name)
        lines += [f"{indent}{_text(name)}:{'' if differing else ' {}'}", *differing]
    return [*lines, ""]


def _differing(value: Any, base: Any, indent: str, name: str) -> list[str]:
    lines = []
    for spec in dataclasses.fields(value):
        ours, theirs = getattr(value, spec.name), getattr(base, spec.name)
        own = spec.metadata.get("own", "")
        if ours == (own.format(name=name) if own else theirs):
            continue
        if dataclasses.is_dataclass(ours):
            inner = _differing(ours, theirs, indent + "  ", name)
            lines += [f"{indent}{spec.name}:", *inner] if inner else []
        else:
            lines.append(f"{indent}{spec.name}: {_text(ours)}")
    return lines


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{}"
    if isinstance(value, tuple):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return repr(value)
