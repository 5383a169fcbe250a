"""YAML mappings read by known key, every complaint with file, line and column.

PyYAML's loaders guess types from text, and guess wrong in silence: ``1:30`` is 90, ``on`` is true,
of two equal keys the last one wins. Here only its composer is used, which keeps text and places.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import yaml

from ertis_simulator.errors import SceneError

MAX_SCENE_BYTES = 65_536
MAX_DEPTH = 8  # a scene has 4
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


class _Composer(yaml.SafeLoader):
    """Composes nodes; refuses what a scene needs not and a parser suffers from."""

    depth = 0

    def compose_node(self, parent: object, index: object) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        mark: Any = event.start_mark  # of the C or the Python reader: alike
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases are not allowed", problem_mark=mark)
        self.depth += 1
        if self.depth > MAX_DEPTH:
            problem = f"nested deeper than {MAX_DEPTH} levels"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
        node = super().compose_node(parent, index)  # type: ignore[arg-type]
        self.depth -= 1
        return node


def read_yaml(path: Path, known: Collection[str]) -> Section:
    """Compose a file whose top is a mapping.

    Raises
    ------
    SceneError
        One line: what, where, and what was expected.
    """
    try:
        if path.stat().st_size > MAX_SCENE_BYTES:
            raise SceneError(f"{path}: larger than {MAX_SCENE_BYTES} bytes: that is no scene")
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=_Composer)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not text"
        raise SceneError(f"scene {path}: {reason}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f":{mark.line + 1}:{mark.column + 1}" if mark else ""
        raise SceneError(f"{path}{where}: not YAML: {getattr(error, 'problem', error)}") from error
    if node is None:
        raise SceneError(f"{path}:1:1: met nothing, expected a mapping such as 'seed: 1'")
    return Section(node, str(path), "", known)


class Section:
    """A mapping with known keys; says what is wrong where.

    Parameters
    ----------
    node : what was composed
    file : str
        Its name, for complaints.
    name : str
        Dotted name of the section, empty for the whole file.
    known : its keys
    """

    def __init__(self, node: yaml.Node, file: str, name: str, known: Collection[str]) -> None:
        self.file, self.name, self.node = file, name, node
        if not isinstance(node, yaml.MappingNode):
            raise self._wrong(node, name or "the file", f"met {_said(node)}, expected a mapping")
        self._nodes: dict[str, yaml.Node] = {}
        for key_node, value in node.value:
            key = str(key_node.value)
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = (
                    f"did you mean {near[0]!r}?" if near else f"known: {', '.join(sorted(known))}"
                )
                raise self._wrong(key_node, self.path(key), f"unknown key, {hint}")
            if key in self._nodes:
                first = self._nodes[key].start_mark.line + 1
                problem = f"given twice, first in line {first}: remove one"
                raise self._wrong(key_node, self.path(key), problem)
            self._nodes[key] = value

    def path(self, key: str) -> str:
        """Dotted name of a key of it."""
        return f"{self.name}.{key}" if self.name else key

    def has(self, key: str) -> bool:
        """Whether the file gives it."""
        return key in self._nodes

    def wrong(self, key: str, problem: str) -> SceneError:
        """Make the error for a key, at its place, or at that of the section without it."""
        return self._wrong(self._nodes.get(key, self.node), self.path(key), problem)

    def _wrong(self, node: yaml.Node, path: str, problem: str) -> SceneError:
        mark = node.start_mark
        return SceneError(f"{self.file}:{mark.line + 1}:{mark.column + 1}: {path}: {problem}")

    def number(
        self, key: str, default: float | None = None, *, low: float = -1e6, high: float = 1e6
    ) -> float:
        """Read a finite number; without ``default`` it has to be there."""
        node = self._nodes.get(key)
        if node is None:
            if default is None:
                raise self.wrong(key, "missing, expected a number")
            return default
        value = self._parse(node, key)
        if not low <= value <= high:
            raise self.wrong(key, f"met {value:g}, expected {low:g} to {high:g}")
        return value

    def _parse(self, node: yaml.Node, key: str) -> float:
        text = node.value if isinstance(node, yaml.ScalarNode) else ""
        if (
            not isinstance(text, str)
            or not _NUMBER.fullmatch(text)
            or not math.isfinite(float(text))
        ):
            raise self._wrong(node, self.path(key), f"met {_said(node)}, expected a number")
        return float(text)

    def pair(self, key: str, default: tuple[float, float]) -> tuple[float, float]:
        """Read two numbers."""
        if key not in self._nodes:
            return default
        values = self.numbers(key)
        if len(values) != 2:
            raise self.wrong(key, f"met {_said(self._nodes[key])}, expected two numbers")
        return values[0], values[1]

    def numbers(self, key: str) -> list[float]:
        """Read a list of numbers; empty without the key."""
        node = self._nodes.get(key)
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            raise self.wrong(key, f"met {_said(node)}, expected a list of numbers")
        return [self._parse(item, key) for item in node.value]

    def text(self, key: str, default: str | None = None, choices: Collection[str] = ()) -> str:
        """Read a word; with ``choices``, one of them."""
        node = self._nodes.get(key)
        if node is None and default is not None:
            return default
        if not isinstance(node, yaml.ScalarNode):
            told = "missing" if node is None else f"met {_said(node)}"
            raise self.wrong(key, f"{told}, expected {_one_of(choices)}")
        value = str(node.value)
        if choices and value not in choices:
            near = difflib.get_close_matches(value, choices, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"expected {_one_of(choices)}"
            raise self.wrong(key, f"met {value!r}, {hint}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """Read true or false."""
        if key not in self._nodes:
            return default
        return self.text(key, choices=("true", "false")) == "true"

    def section(self, key: str, known: Collection[str]) -> Section | None:
        """Read a mapping in it; None without the key."""
        node = self._nodes.get(key)
        return None if node is None else Section(node, self.file, self.path(key), known)

    def sections(self, key: str, known: Collection[str]) -> list[Section]:
        """Read a list of mappings; empty without the key."""
        node = self._nodes.get(key)
        if node is None:
            return []
        if not isinstance(node, yaml.SequenceNode):
            raise self.wrong(key, f"met {_said(node)}, expected a list")
        name = self.path(key)
        return [Section(n, self.file, f"{name}[{i}]", known) for i, n in enumerate(node.value)]


def _one_of(choices: Collection[str]) -> str:
    return f"one of {', '.join(choices)}" if choices else "a word"


def _said(node: yaml.Node) -> str:
    """What the file says there, short enough for a line."""
    if isinstance(node, yaml.ScalarNode):
        return repr(str(node.value)[:40])
    return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"
