"""The daemon's configuration: what can be set, its defaults, its bounds."""

# ruff: noqa: RUF009  # option() and section() are dataclasses.field() with metadata of ours
from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ertis_daemon.yaml_load import ConfigError, Marks, load, option, section
from ertis_driver.chirp import DEFAULT_CHIRP, Chirp, ChirpKind
from ertis_driver.device import Settings
from ertis_driver.errors import SettingsError
from ertis_driver.frame import DEFAULT_NUM_WORDS

__all__ = ["Config", "ConfigError", "example_yaml", "load_config", "parse_config"]

SPEED_AT_0_C_M_S = 331.3  # dry air at 0 degrees Celsius


def _check_chunk(value: str) -> str | None:
    if not value or any(c in "/*?#$@" or c.isspace() or not c.isprintable() for c in value):
        return f"{value!r}, expected a Zenoh key chunk: not empty, no / * ? # $ @ and no blanks"
    return None


def _check_key(value: str) -> str | None:
    return next(filter(None, map(_check_chunk, value.split("/"))), None) if value else None


def _check_filled(value: str) -> str | None:
    return None if value.strip() else "empty, expected text"


def _check_locators(values: tuple[str, ...]) -> str | None:
    for value in values:
        protocol, _, place = value.partition("/")
        if not (protocol.isidentifier() or "-" in protocol) or not place or " " in value:
            return f"{value!r}, expected a Zenoh locator such as tcp/localhost:7447"
    return None


@dataclass(frozen=True, slots=True)
class DeviceConfig:
    """Which sonar, and what it is called on the network."""

    name: str = option("ertis", "keys on Zenoh are ertis/NAME/...", check=_check_chunk)
    address: str = option(
        "serial:/dev/ertis0",
        "serial:PORT, serial:sn=NUMBER, usb:VID:PID, replay:FILE or sim:SCENE",
        check=_check_filled,
    )
    frame_id: str = option("sonar", "coordinate frame named in events", check=_check_filled)


@dataclass(frozen=True, slots=True)
class ChirpConfig:
    """The emitted sweep."""

    kind: ChirpKind = option(DEFAULT_CHIRP.kind, "hyperbolic or linear")
    f_start_hz: float = option(DEFAULT_CHIRP.f_start_hz, "first frequency, Hz", low=1)
    f_stop_hz: float = option(DEFAULT_CHIRP.f_stop_hz, "last frequency, Hz", low=1)
    duration_s: float = option(DEFAULT_CHIRP.duration_s, "length, s", low=0, high=1)
    ramp: float = option(
        DEFAULT_CHIRP.ramp, "part of it that each Hann ramp covers", low=0, high=0.5
    )
    dac_rate_hz: int = option(DEFAULT_CHIRP.dac_rate_hz, "rate at which it is played, Hz", low=1)


@dataclass(frozen=True, slots=True)
class DetectorConfig:
    """What recognises landmarks."""

    model: str = option("", "model file; empty for the shipped one that fits the chirp")
    min_probability: float = option(
        0.0, "a landmark less probable is not reported; 0: the model's own", low=0, high=1
    )


@dataclass(frozen=True, slots=True)
class TrackerConfig:
    """When a landmark is announced, and how long it is remembered."""

    max_false_events_per_hour: float = option(
        1.0,
        "announcements of what is no landmark or has another size; less asks for more pings",
        low=1e-3,
        high=1e6,
    )
    landmarks_per_hour: float = option(
        60.0, "landmarks that the robot meets; of so many the wrong sizes count", low=1.0, high=1e6
    )
    max_speed_m_s: float = option(
        1.0, "of the sonar, m/s, for pings without odometry", low=0, high=50
    )
    max_turn_deg_s: float = option(60.0, "of the sonar, degrees/s, likewise", low=0, high=3600)
    max_silence_s: float = option(
        1.5, "a landmark in view and not heard is lost no sooner", low=0, high=3600
    )
    max_unheard_s: float = option(
        10.0, "a landmark not heard for so long is lost, in view or not", low=0.1, high=3600
    )


@dataclass(frozen=True, slots=True)
class OdometryConfig:
    """Where the robot says that it is, if it does."""

    key: str = option(
        "",
        "Zenoh key of the robot's poses, for example robot/odometry; empty: none",
        check=_check_key,
    )
    max_age_s: float = option(
        0.5, "poses farther apart, or older than a ping by more, are not used", low=0.01, high=10
    )
    x_m: float = option(0.0, "sonar on the robot: forward of the robot's origin, m")
    y_m: float = option(0.0, "left of it, m")
    yaw_deg: float = option(0.0, "turned left, degrees", low=-360, high=360)


@dataclass(frozen=True, slots=True)
class ZenohConfig:
    """How to reach the network."""

    mode: Literal["peer", "client"] = option(
        "peer", "peer works without a router; client wants one and fails without"
    )
    connect: tuple[str, ...] = option(
        ("tcp/localhost:7447",),
        "locators to connect to, tried again and again",
        check=_check_locators,
    )
    listen: tuple[str, ...] = option(
        ("tcp/localhost:0",), "locators to listen on; port 0 is any free one", check=_check_locators
    )


@dataclass(frozen=True, slots=True)
class Config:
    """All of it. Angles and temperatures are in degrees here, as people say them."""

    device: DeviceConfig = section(DeviceConfig, "which sonar, and what it is called")
    chirp: ChirpConfig = section(ChirpConfig, "the emitted sweep")
    detector: DetectorConfig = section(DetectorConfig, "what recognises landmarks")
    tracker: TrackerConfig = section(TrackerConfig, "when a landmark is announced")
    odometry: OdometryConfig = section(OdometryConfig, "where the robot says that it is")
    zenoh: ZenohConfig = section(ZenohConfig, "how to reach the network")
    num_words: int = option(
        DEFAULT_NUM_WORDS, "PDM words to listen for, a multiple of 32768; 163840 reach 6.2 m", low=1
    )
    temperature_c: float = option(
        20.0, "of the air, degrees Celsius; sets the speed of sound", low=-60, high=80
    )
    ping_rate_hz: float = option(0.0, "pings a second; 0 for as fast as it goes", low=0, high=100)
    queue_size: int = option(
        2, "pings that may wait to be processed; a live sonar drops the oldest", low=1, high=64
    )
    max_pings: int = option(0, "end after so many pings heard; 0 for never", low=0)

    @property
    def speed_of_sound_m_s(self) -> float:
        """331.3 sqrt(1 + T / 273.15), m/s: dry air as an ideal gas."""
        return SPEED_AT_0_C_M_S * math.sqrt(1.0 + self.temperature_c / 273.15)

    def settings(self) -> Settings:
        """Return what the sonar is configured with.

        Raises
        ------
        SettingsError
            If the device would not accept it.
        """
        c = self.chirp
        chirp = Chirp(c.kind, c.f_start_hz, c.f_stop_hz, c.duration_s, c.ramp, c.dac_rate_hz)
        return Settings(chirp=chirp, num_words=self.num_words)

    def to_json(self) -> dict[str, Any]:
        """Return the effective values, as served on Zenoh."""
        return dataclasses.asdict(self)


def parse_config(data: bytes, name: str = "config") -> Config:
    """Read a configuration from YAML text.

    Raises
    ------
    ConfigError
        With every error found, one a line: ``name:line:column: key: what is wrong``.
    """
    marks = Marks(name)
    config = load(Config, data, marks)
    try:
        Chirp(**dataclasses.asdict(config.chirp))
    except SettingsError as error:
        marks.add("chirp", str(error))
    try:
        Settings(num_words=config.num_words)
    except SettingsError as error:
        marks.add("num_words", str(error))
    marks.raise_errors()
    return config


def load_config(path: Path) -> Config:
    """Read a configuration file.

    Raises
    ------
    ConfigError
        If it cannot be read, or with every error in it.
    """
    try:
        with path.open("rb") as file:
            data = file.read(64 * 1024 + 1)  # never all of a wrong file
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from error
    return parse_config(data, str(path))


def example_yaml(config: Config | None = None) -> str:
    """Write a configuration, or the defaults, as commented YAML that reads back equal."""
    return "\n".join(_example_lines(config or Config(), "")) + "\n"


def _example_lines(node: Any, indent: str) -> list[str]:
    lines = []
    for spec in dataclasses.fields(node):
        value = getattr(node, spec.name)
        lines.append(f"{indent}# {spec.metadata['doc']}")
        if dataclasses.is_dataclass(value):
            lines += [f"{indent}{spec.name}:", *_example_lines(value, indent + "  "), ""]
        else:
            lines.append(f"{indent}{spec.name}: {_yaml_text(value)}")
    return lines


def _yaml_text(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml_text(item) for item in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return repr(value)
