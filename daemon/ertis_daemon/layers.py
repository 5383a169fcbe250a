"""Where the configuration comes from: files, the environment, flags; the later one wins."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from ertis_daemon.config import Config
from ertis_daemon.config_read import build_config, read_config_file
from ertis_daemon.yaml_nodes import Marks, compose, merge, note_duplicates, text_node

SYSTEM_FILE = Path("/etc/ertis/ertis.yaml")
PREFIX = "ERTIS_"
REPLACED = ("sonars",)  # the sonars of a file are all there are, not more than in the one before


@dataclass(frozen=True, slots=True)
class Sources:
    """What a configuration is read from, again and again.

    file : Path or None
        Named by the user: it must exist. The system's and the user's own file need not.
    flags : mapping of dotted key to text
        ``{"device.name": "front"}``; "command line" in messages.
    system_file : Path
        Of the machine.
    environment : mapping or None
        None for the process's own.
    """

    file: Path | None = None
    flags: Mapping[str, str] | None = None
    system_file: Path = SYSTEM_FILE
    environment: Mapping[str, str] | None = None

    def files(self) -> tuple[Path, ...]:
        """The files that are there, the weakest first; the one named, there or not."""
        found = [path for path in (self.system_file, self._user_file()) if path and _exists(path)]
        if self.file is not None and self.file not in found:
            found.append(self.file)
        return tuple(found)

    def load(self) -> Config:
        """Read all of it.

        Raises
        ------
        ConfigError
            If a file cannot be read, or with every error in each of them.
        """
        files = self.files()
        marks = Marks(str(files[-1]) if files else "configuration")
        node: yaml.Node | None = None
        for path in files:
            over = compose(read_config_file(path), str(path))
            note_duplicates(over, "", marks)
            node = merge(node, over, whole=REPLACED)
        for key, text, name in [*self._variables(), *self._flags()]:
            node = merge(node, text_node(key, text, name))
        return build_config(node, marks)

    def _environ(self) -> Mapping[str, str]:
        return os.environ if self.environment is None else self.environment

    def _user_file(self) -> Path | None:
        environ = self._environ()
        home = environ.get("HOME", "")
        base = environ.get("XDG_CONFIG_HOME") or (f"{home}/.config" if home else "")
        return Path(base) / "ertis" / "ertis.yaml" if base else None

    def _variables(self) -> list[tuple[str, str, str]]:
        return [
            (name[len(PREFIX) :].lower().replace("__", "."), text, f"environment: {name}")
            for name, text in sorted(self._environ().items())
            if name.startswith(PREFIX)
        ]

    def _flags(self) -> list[tuple[str, str, str]]:
        return [(key, text, "command line") for key, text in (self.flags or {}).items()]


def _exists(path: Path) -> bool:
    """Whether it is there, as far as we may see: a service may be shut out of its home."""
    try:
        return path.exists()
    except OSError:
        return False
