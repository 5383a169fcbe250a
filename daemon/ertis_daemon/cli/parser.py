"""The ``ertis`` command's parsers. Nothing heavy is imported: ``ertis --help`` waits for this."""

from __future__ import annotations

import argparse
import importlib
import os
import re
import sys

TYPE_CHECKING = False  # typing's own, without the milliseconds of importing it
if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Any, NoReturn

_LEAST_COLUMNS = 40
DESCRIPTION = "Landmark recognition with the eRTIS in-air sonar."
EPILOG = """\
example:
  ertis demo

exit codes: 0 ok, 1 failed, 2 wrong usage, 3 done with losses or findings, 130 interrupted

Results go to stdout, messages to stderr. `ertis COMMAND --help` tells more of a command;
`eval "$(ertis completion bash)"` completes words.
"""


class Formatter(argparse.RawDescriptionHelpFormatter):
    """As wide as the terminal; argparse would import all of shutil to find that out."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns() - 2)


class Parser(argparse.ArgumentParser):
    """Keeps the line breaks of epilogs, and says which word may have been meant."""

    def __init__(self, **options: Any) -> None:
        options.setdefault("formatter_class", Formatter)
        super().__init__(**options)
        self.said: Sequence[str] = ()

    def error(self, message: str) -> NoReturn:
        """Print usage and what was wrong, with the nearest known word; the exit code is 2."""
        self.print_usage(sys.stderr)
        self.exit(2, f"{self.prog}: {message}{self._meant(message)}\n")

    def _meant(self, message: str) -> str:
        choice = re.search(r"invalid choice: '([^']*)'", message)
        if choice:
            return _suggestion(choice[1], parts_of(self))
        unknown = message.partition("unrecognized arguments: ")[2].split()
        known = [flag for parser in self._named() for flag in flags_of(parser)]
        options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
        return _suggestion(options[0], known) if options else ""

    def _named(self) -> Iterator[argparse.ArgumentParser]:
        """Itself, and the parts of it that were asked for."""
        parser: argparse.ArgumentParser = self
        yield parser
        for word in self.said:
            parser = parts_of(parser).get(word, parser)
            yield parser


class ShowVersion(argparse.Action):
    """``--version``, looked up only if asked for: that takes longer than all the help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print it and end."""
        from ertis_daemon.about import version

        print(f"ertis {version() or 'of a source tree that is not installed'}")
        parser.exit()


def build_parser(
    commands: Mapping[str, tuple[str, str]], wanted: str | None, *, every: bool = False
) -> Parser:
    """Parser of all commands, with the flags of the wanted one, or of every one."""
    parser = Parser(prog="ertis", description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="show the version and exit")
    parts = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module_name, text) in commands.items():
        command = parts.add_parser(name, help=text, description=text)
        if every or name == wanted:
            importlib.import_module(module_name).add_arguments(command)
            _add_example(name, command)
    return parser


def parts_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Its subcommands by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def flags_of(parser: argparse.ArgumentParser) -> list[str]:
    """Its long options, and short ones that have no long name."""
    flags: list[str] = []
    for action in parser._actions:
        long = [flag for flag in action.option_strings if flag.startswith("--")]
        flags += long or action.option_strings
    return flags


def _columns() -> int:
    asked = os.environ.get("COLUMNS", "")
    if asked.isdecimal() and int(asked) > _LEAST_COLUMNS:
        return int(asked)
    try:
        return max(os.get_terminal_size(sys.__stdout__.fileno()).columns, _LEAST_COLUMNS)  # type: ignore[union-attr]
    except (AttributeError, ValueError, OSError):  # no terminal
        return 80


def _add_example(name: str, command: argparse.ArgumentParser) -> None:
    from ertis_daemon.cli.examples import EXAMPLES

    if name in EXAMPLES and not re.search("(?i)examples?:\n", command.epilog or ""):
        before = f"{command.epilog.rstrip()}\n\n" if command.epilog else ""
        command.epilog = f"{before}example:\n  {EXAMPLES[name]}\n"


def _suggestion(word: str, known: Sequence[str] | Mapping[str, object]) -> str:
    from difflib import get_close_matches

    near = get_close_matches(word, list(known), 1)
    return f"; did you mean {near[0]!r}?" if near else ""
