"""``ertis completion``: words for the shell, from the parsers themselves."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

EPILOG = """\
examples:
  eval "$(ertis completion bash)"                                      # in ~/.bashrc
  ertis completion zsh > "${fpath[1]}/_ertis"                          # then start a new shell
  ertis completion fish > ~/.config/fish/completions/ertis.fish
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="which shell")
    parser.epilog = EPILOG


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    from ertis_daemon.cli import COMMANDS
    from ertis_daemon.cli.parser import build_parser

    levels = list(_levels("", build_parser(COMMANDS, None, every=True)))
    print({"bash": _bash, "zsh": _zsh, "fish": _fish}[args.shell](levels), end="")
    return 0


@dataclass(frozen=True, slots=True)
class Level:
    """What may follow after some commands.

    path : str
        ``dataset check``; empty for ``ertis`` alone.
    parts : dict
        Its subcommands and what they are for.
    flags : dict
        Its options and what they are for.
    choices : dict
        By option, the values it takes if these can be told.
    taking : set
        Options that take a value.
    values : list
        What its other arguments may be, if that can be told.
    """

    path: str
    parts: dict[str, str]
    flags: dict[str, str]
    choices: dict[str, list[str]]
    taking: set[str]
    values: list[str]


def _levels(path: str, parser: argparse.ArgumentParser) -> Iterator[Level]:
    level = Level(path, {}, {}, {}, set(), [])
    below: dict[str, argparse.ArgumentParser] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            below = dict(action.choices)
            level.parts.update({one.dest: one.help or "" for one in action._choices_actions})
            continue
        choices = [str(choice) for choice in action.choices or ()]
        if not action.option_strings:
            level.values.extend(choices)
        for flag in action.option_strings:
            level.flags[flag] = (action.help or "").replace("%%", "%").replace("\n", " ")
            if choices:
                level.choices[flag] = choices
            if action.nargs != 0:
                level.taking.add(flag)
    yield level
    for name, part in below.items():
        yield from _levels(f"{path} {name}".strip(), part)


def _bash(levels: list[Level]) -> str:
    return (
        "# ertis completion for bash\n"
        "_ertis() {\n"
        '  local at="" words="" word i cur="${COMP_WORDS[COMP_CWORD]}" prev=""\n'
        "  COMPREPLY=()\n"
        "  for ((i = 1; i < COMP_CWORD; i++)); do\n"
        '    word="${COMP_WORDS[i]}"; prev="$word"\n'
        f'    case "$at/$word" in\n{_descend(levels)}    esac\n'
        "  done\n"
        f"{_values(levels)}"
        '  case "$at" in\n'
        + "".join(f"    {_quoted(lv.path)}) words={_quoted(_words(lv))} ;;\n" for lv in levels)
        + "  esac\n"
        '  COMPREPLY=($(compgen -W "$words" -- "$cur"))\n'
        "}\n"
        "complete -o default -F _ertis ertis\n"
    )


def _zsh(levels: list[Level]) -> str:
    return (
        "#compdef ertis\n"
        "_ertis() {\n"
        '  local at="" word i prev=""\n'
        "  local -a found\n"
        "  for ((i = 2; i < CURRENT; i++)); do\n"
        '    word="$words[i]"; prev="$word"\n'
        f'    case "$at/$word" in\n{_descend(levels)}    esac\n'
        "  done\n"
        f"{_values(levels, zsh=True)}"
        '  case "$at" in\n'
        + "".join(f"    {_quoted(lv.path)}) found=({_words(lv)}) ;;\n" for lv in levels)
        + "  esac\n"
        "  compadd -a found\n"
        "  _files\n"
        "}\n"
        'if [ "$funcstack[1]" = "_ertis" ]; then _ertis "$@"; else compdef _ertis ertis; fi\n'
    )


def _descend(levels: list[Level]) -> str:
    """Cases that follow the commands down: ``at`` becomes the longer path."""
    return "".join(
        f"      {_quoted(f'{lv.path.rpartition(chr(32))[0]}/{lv.path.rpartition(chr(32))[2]}')}) "
        f"at={_quoted(lv.path)} ;;\n"
        for lv in levels
        if lv.path
    )


def _values(levels: list[Level], *, zsh: bool = False) -> str:
    """Cases where the word before takes a value: one of some, or anything, mostly a file."""
    lines = []
    for level in levels:
        for flag in sorted(level.taking):
            choices = " ".join(level.choices.get(flag, []))
            if zsh:
                then = f"compadd -- {choices}; return" if choices else "_files; return"
            else:
                then = f'COMPREPLY=($(compgen -W {_quoted(choices)} -- "$cur")); return'
            lines.append(f"    {_quoted(f'{level.path}/{flag}')}) {then} ;;\n")
    return f'  case "$at/$prev" in\n{"".join(lines)}  esac\n'


def _words(level: Level) -> str:
    return " ".join([*level.parts, *level.values, *level.flags])


def _fish(levels: list[Level]) -> str:
    lines = [
        "# ertis completion for fish",
        "function __ertis_at",
        "  set -l at",
        "  for word in (commandline -opc)[2..-1]",
        '    switch "$at/$word"',
    ]
    for level in levels:
        if level.path:
            up, _, name = level.path.rpartition(" ")
            lines += [
                f"      case {_quoted(f'{up}/{name}')}",
                f"        set at {_quoted(level.path)}",
            ]
    lines += ["    end", "  end", '  test "$at" = "$argv[1]"', "end"]
    for level in levels:
        here = f"complete -c ertis -n {_quoted(f'__ertis_at {_quoted(level.path)}')}"
        for name, text in level.parts.items():
            lines.append(f"{here} -f -a {_quoted(name)} -d {_quoted(text)}")
        for value in level.values:
            lines.append(f"{here} -f -a {_quoted(value)}")
        for flag, text in level.flags.items():
            kind = "-l" if flag.startswith("--") else "-s"
            takes = " -r" if flag in level.taking else ""
            if flag in level.choices:
                takes += f" -f -a {_quoted(' '.join(level.choices[flag]))}"
            lines.append(f"{here} {kind} {flag.lstrip('-')}{takes} -d {_quoted(text)}")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    return shlex.quote(text)
