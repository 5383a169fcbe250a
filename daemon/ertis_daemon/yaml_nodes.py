"""YAML text to nodes that remember where they stand, and one file's nodes laid over another's."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import yaml

from ertis_driver.errors import ErtisError

MAX_BYTES = 64 * 1024  # a whole configuration is 5 kB; more is a wrong file
MAX_DEPTH = 8  # the deepest one of ours is 5

_NULLS = ("", "~", "null", "Null", "NULL")


class ConfigError(ErtisError):
    """The configuration is wrong: correct the lines named, one error a line."""


class Place(NamedTuple):
    """Where something stands; line 0 is no line, as of an environment variable."""

    name: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.name}:{self.line}:{self.column}" if self.line else self.name


@dataclass(slots=True)
class Marks:
    """Where each key stands and what was wrong; ``path`` is dotted, empty for the whole file.

    name : str
        Of the file, where an error stands nowhere else.
    """

    name: str
    errors: dict[Place, str] = field(default_factory=dict)
    places: dict[str, Place] = field(default_factory=dict)

    def add(self, path: str, message: str, place: Place | None = None) -> None:
        """Note an error at ``place``, or where ``path`` or the section around it stands.

        Only the first one of a place: what is laid over several sonars is wrong once.
        """
        outer = path
        while place is None:
            place = self.places.get(outer) or (None if outer else Place(self.name, 1, 1))
            outer = outer.rpartition(".")[0]
        self.errors.setdefault(place, f"{path}: {message}" if path else message)

    def raise_errors(self) -> None:
        """Raise all errors at once, in the order of their lines.

        Raises
        ------
        ConfigError
            If there are any.
        """
        if self.errors:
            lines = (f"{place}: {text}" for place, text in sorted(self.errors.items()))
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


def compose(data: bytes, name: str) -> yaml.Node | None:
    """Nodes of a YAML text; None if there are none in it.

    Raises
    ------
    ConfigError
        If the text is no YAML at all, too large or too deep.
    """
    try:
        if len(data) > MAX_BYTES:
            raise ConfigError(f"{name}: larger than {MAX_BYTES} bytes, is it the right file?")
        loader = _Composer(data.decode("utf-8-sig"))
        loader.name = name  # each mark's
        try:
            node: yaml.Node | None = loader.get_single_node()
        finally:
            loader.dispose()
        return node
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        raise ConfigError(f"{name}:{place}: {error.problem or error.context}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{name}:1:1: not UTF-8 YAML text: {reason}") from error


def place_of(node: yaml.Node) -> Place:
    """Where a node begins."""
    mark = node.start_mark
    if mark.line < 0:
        return Place(mark.name, 0, 0)
    return Place(mark.name, mark.line + 1, mark.column + 1)


def is_null(node: yaml.Node) -> bool:
    """Whether nothing was written there, or null."""
    return isinstance(node, yaml.ScalarNode) and not node.style and node.value in _NULLS


def text_node(path: str, text: str, name: str) -> yaml.Node:
    """One value that stands in no file, as nodes: ``device.name`` is a section and a key in it."""
    mark = yaml.Mark(name, 0, -1, -1, None, 0)
    scalar = "tag:yaml.org,2002:str"
    node: yaml.Node
    if text.lstrip().startswith("["):
        composed = compose(text.encode(), name)
        assert composed is not None  # there is a bracket in it
        node = composed
        node.start_mark = mark
    else:
        node = yaml.ScalarNode(scalar, text, mark, mark, style='"')
    for key in reversed(path.split(".")):
        key_node = yaml.ScalarNode(scalar, key, mark, mark)
        node = yaml.MappingNode("tag:yaml.org,2002:map", [(key_node, node)], mark, mark)
    return node


def merge(
    base: yaml.Node | None, over: yaml.Node | None, *, whole: Collection[str] = ()
) -> yaml.Node | None:
    """One node laid over another: sections key by key, anything else replaced.

    Parameters
    ----------
    base, over
        None is nothing.
    whole
        Keys of this section that are replaced even if both are sections.
    """
    if over is None or (is_null(over) and isinstance(base, yaml.MappingNode)):
        return base
    if not (isinstance(base, yaml.MappingNode) and isinstance(over, yaml.MappingNode)):
        return over
    pairs = list(base.value)
    at = {key: index for index, (key, _) in enumerate(_named(pairs))}
    for key, (key_node, node) in _named(over.value):
        if key not in at:
            pairs.append((key_node, node))
            continue
        merged = node if key in whole else merge(pairs[at[key]][1], node)
        pairs[at[key]] = (key_node, merged or node)
    return yaml.MappingNode(base.tag, pairs, over.start_mark, over.end_mark)


def _named(
    pairs: list[tuple[yaml.Node, yaml.Node]],
) -> Iterator[tuple[str, tuple[yaml.Node, yaml.Node]]]:
    for key_node, node in pairs:
        yield key_name(key_node), (key_node, node)


def key_name(node: yaml.Node) -> str:
    """A key as text; ``?`` for one that is no text."""
    return str(node.value) if isinstance(node, yaml.ScalarNode) else "?"


def note_duplicates(node: yaml.Node | None, path: str, marks: Marks) -> None:
    """Find keys that one file gives twice, of which YAML's own loaders take the last."""
    if not isinstance(node, yaml.MappingNode):
        return
    seen: dict[str, Place] = {}
    for key, (key_node, value) in _named(node.value):
        where = f"{path}.{key}" if path else key
        if key in seen:
            message = f"given twice, first in line {seen[key].line}"
            marks.add(where, message, place_of(key_node))
        seen.setdefault(key, place_of(key_node))
        note_duplicates(value, where, marks)


def take_key(node: yaml.Node | None, key: str) -> tuple[yaml.Node | None, yaml.Node | None]:
    """A section without one of its keys, and what stood under that."""
    if not isinstance(node, yaml.MappingNode):
        return node, None
    taken = [value for name, (_, value) in _named(node.value) if name == key]
    rest = [pair for name, pair in _named(node.value) if name != key]
    shorter = yaml.MappingNode(node.tag, rest, node.start_mark, node.end_mark)
    return shorter, taken[-1] if taken else None
