"""Nodes and files to a configuration, with what no single key can be wrong about."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import yaml

from ertis_daemon.config import Config, DeviceConfig, SonarConfig, check_chunk
from ertis_daemon.yaml_load import load
from ertis_daemon.yaml_nodes import (
    MAX_BYTES,
    ConfigError,
    Marks,
    compose,
    merge,
    note_duplicates,
    place_of,
    take_key,
)
from ertis_driver.chirp import Chirp
from ertis_driver.device import Settings
from ertis_driver.errors import SettingsError
from ertis_driver.open import is_hardware


def build_config(node: yaml.Node | None, marks: Marks) -> Config:
    """Read a configuration from nodes.

    Raises
    ------
    ConfigError
        With every error found, one a line: ``name:line:column: key: what is wrong``.
    """
    shared, listed = take_key(node, "sonars")
    config = load(Config, shared, marks)
    if listed is not None:
        sonars = _sonars(listed, shared, marks)
        config = dataclasses.replace(config, sonars=sonars)
    for name, sonar in config.sonars.items() or [("", config)]:
        _check_sonar(sonar, f"sonars.{name}." if name else "", config, marks)
    if not marks.errors:  # what is refused has its default's value
        _check_distinct(config, marks)
    marks.raise_errors()
    return config


def _sonars(listed: yaml.Node, shared: yaml.Node | None, marks: Marks) -> dict[str, SonarConfig]:
    if not isinstance(listed, yaml.MappingNode):
        marks.add("sonars", "expected 'name:' lines, each with a section", place_of(listed))
        return {}
    for spec in dataclasses.fields(Config):
        if spec.name not in SonarConfig.__dataclass_fields__:
            shared, _ = take_key(shared, spec.name)
    sonars = {}
    for key_node, node in listed.value:
        name, path = str(key_node.value), f"sonars.{key_node.value}"
        problem = check_chunk(name) if isinstance(key_node, yaml.ScalarNode) else "no name"
        if problem:
            marks.add("sonars", problem, place_of(key_node))
            continue
        marks.places[path] = place_of(key_node)
        sonar = load(SonarConfig, merge(shared, node), marks, path)
        _, said = take_key(node, "device")
        device = _own(sonar.device, said, name)
        if device.name != name:
            marks.add(
                f"{path}.device.name", f"{device.name!r}, but its key is its name: leave it out"
            )
        sonars[name] = dataclasses.replace(sonar, device=device)
    return sonars


def _own(device: DeviceConfig, said: yaml.Node | None, name: str) -> DeviceConfig:
    """A device among several: what it does not say itself goes by its name."""
    values = {
        spec.name: spec.metadata["own"].format(name=name)
        for spec in dataclasses.fields(device)
        if spec.metadata["own"] and take_key(said, spec.name)[1] is None
    }
    return dataclasses.replace(device, **values)


def _check_sonar(sonar: SonarConfig, path: str, config: Config, marks: Marks) -> None:
    try:
        Chirp(**dataclasses.asdict(sonar.chirp))
    except SettingsError as error:
        marks.add(f"{path}chirp", str(error))
    try:
        Settings(num_words=sonar.num_words)
    except SettingsError as error:
        marks.add(f"{path}num_words", str(error))
    if sonar.ping_on == "command" and not config.zenoh.commands:
        marks.add(f"{path}ping_on", "command, which needs zenoh.commands: true")


def _check_distinct(config: Config, marks: Marks) -> None:
    seen: dict[str, str] = {}
    for name, sonar in config.sonars.items():
        address = sonar.device.address
        other = seen.setdefault(address, name)
        if other != name and is_hardware(address):
            message = f"the same device.address as {other!r} has: give each its own"
            marks.add(f"sonars.{name}", message)


def parse_config(data: bytes, name: str = "config") -> Config:
    """Read a configuration from YAML text.

    Raises
    ------
    ConfigError
        With every error found, one a line: ``name:line:column: key: what is wrong``.
    """
    marks = Marks(name)
    node = compose(data, name)
    note_duplicates(node, "", marks)
    return build_config(node, marks)


def load_config(path: Path) -> Config:
    """Read a configuration file.

    Raises
    ------
    ConfigError
        If it cannot be read, or with every error in it.
    """
    return parse_config(read_config_file(path), str(path))


def read_config_file(path: Path) -> bytes:
    """Read a file, but never all of a wrong one.

    Raises
    ------
    ConfigError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
