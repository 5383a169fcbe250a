"""The daemon's configuration: what can be set, its defaults, its bounds."""

# ruff: noqa: RUF009  # option() and section() are dataclasses.field() with metadata of ours
from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ertis_daemon.ros2.config import Ros2Config
from ertis_daemon.yaml_example import write_yaml
from ertis_daemon.yaml_load import option, section
from ertis_detector.air import Air
from ertis_driver.chirp import DEFAULT_CHIRP, Chirp, ChirpKind
from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.errors import AddressError
from ertis_driver.frame import DEFAULT_NUM_WORDS
from ertis_driver.open import split_address


def check_chunk(value: str) -> str | None:
    """What is wrong with a chunk of a Zenoh key; None if nothing is."""
    if not value or any(c in "/*?#$@" or c.isspace() or not c.isprintable() for c in value):
        return f"{value!r}, expected a Zenoh key chunk: not empty, no / * ? # $ @ and no blanks"
    return None


def _check_key(value: str) -> str | None:
    return next(filter(None, map(check_chunk, value.split("/"))), None) if value else None


def _check_filled(value: str) -> str | None:
    return None if value.strip() else "empty, expected text"


def _check_address(value: str) -> str | None:
    try:
        split_address(value)
    except AddressError as error:
        return str(error) if value.strip() else _check_filled(value)
    return None


def _check_locators(values: tuple[str, ...]) -> str | None:
    for value in values:
        protocol, _, place = value.partition("/")
        if not (protocol.isidentifier() or "-" in protocol) or not place or " " in value:
            return f"{value!r}, expected a Zenoh locator such as tcp/localhost:7447"
    return None


def _check_host(value: str) -> str | None:
    host, colon, port = value.rpartition(":")
    if not value or (host and colon and port.isdecimal() and int(port) < 65536):
        return None
    return f"{value!r}, expected HOST:PORT such as localhost:9464"


RecordOn = Literal["new", "lost", "dead"]
PingOn = Literal["timer", "pin1", "pin2", "command"]


@dataclass(frozen=True, slots=True)
class DeviceConfig:
    """Which sonar, and what it is called on the network."""

    name: str = option("ertis", "keys on Zenoh are ertis/NAME/...", check=check_chunk, own="{name}")
    address: str = option(
        "serial:/dev/ertis0",
        "serial:PORT, serial:sn=NUMBER, usb:VID:PID, replay:FILE or sim:SCENE",
        check=_check_address,
    )
    frame_id: str = option(
        "sonar",
        "coordinate frame named in events; NAME_sonar for one of several that says no other",
        check=_check_filled,
        own="{name}_sonar",
    )


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
        0.0, "an echo less probably a landmark starts no track; 0: 0.5", low=0, high=1
    )


@dataclass(frozen=True, slots=True)
class PoseConfig:
    """Where the sonar sits on the robot: x forward, y left, z up; turned by yaw, pitch, roll."""

    parent_frame: str = option("", "frame that the pose is told in; empty for no transform")
    x_m: float = option(0.0, "forward, m")
    y_m: float = option(0.0, "to the left, m")
    z_m: float = option(0.0, "up, m")
    roll_deg: float = option(0.0, "about x, degrees", low=-360, high=360)
    pitch_deg: float = option(0.0, "about y, degrees; positive looks down", low=-360, high=360)
    yaw_deg: float = option(0.0, "about z, degrees; positive looks left", low=-360, high=360)


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Frames kept for when something happens. Nothing is recorded unless asked for."""

    folder: str = option("", "where recordings go; empty for the service's state folder")
    on: tuple[RecordOn, ...] = option(
        (), "what starts a recording by itself: new (landmark), lost (landmark), dead (microphone)"
    )
    before_s: float = option(2.0, "s of pings from before it that are recorded", low=0, high=60)
    after_s: float = option(1.0, "s of pings from after it", low=0, high=600)
    memory_mb: int = option(64, "of pings kept for that, at most", low=1, high=4096)
    folder_mb: int = option(
        1000, "of this sonar's recordings, at most; the oldest are removed", low=1
    )
    keep_free_mb: int = option(200, "of the disk, which recordings leave free", low=0)


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
    """Where the robot says that it is, if it does; ``pose`` says where the sonar is on it."""

    key: str = option(
        "",
        "Zenoh key of the robot's poses, for example robot/odometry; empty: none",
        check=_check_key,
    )
    max_age_s: float = option(
        0.5, "poses farther apart, or older than a ping by more, are not used", low=0.01, high=10
    )


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
    tls: str = option(
        "", "folder of ca.pem, cert.pem and key.pem, for a router that asks for them; mode client"
    )
    raw: bool = option(False, "offer whole frames on ertis/NAME/raw, 18 MB/s to each subscriber")
    commands: bool = option(
        False, "obey ertis/NAME/cmd/...: anybody on the network may then ping, record and reload"
    )


@dataclass(frozen=True, slots=True)
class PrometheusConfig:
    """Counters for Prometheus; needs the extra 'prometheus'."""

    listen: str = option("", "HOST:PORT to serve /metrics on; empty for none", check=_check_host)


@dataclass(frozen=True, slots=True)
class SonarConfig:
    """One sonar. Angles and temperatures are in degrees here, as people say them."""

    device: DeviceConfig = section(DeviceConfig, "which sonar, and what it is called")
    pose: PoseConfig = section(PoseConfig, "where it sits on the robot")
    chirp: ChirpConfig = section(ChirpConfig, "the emitted sweep")
    detector: DetectorConfig = section(DetectorConfig, "what recognises landmarks")
    tracker: TrackerConfig = section(TrackerConfig, "when a landmark is announced")
    odometry: OdometryConfig = section(OdometryConfig, "where the robot says that it is")
    record: RecordConfig = section(RecordConfig, "pings kept for when something happens")
    num_words: int = option(
        DEFAULT_NUM_WORDS, "PDM words to listen for, a multiple of 32768; 163840 reach 6.2 m", low=1
    )
    temperature_c: float = option(
        20.0, "of the air, degrees Celsius; sets the speed of sound", low=-60, high=80
    )
    humidity_percent: float = option(
        50.0, "of the air, relative: 50 more make ranges 0.19 % longer at 20 C", low=0, high=100
    )
    ping_on: PingOn = option(
        "timer", "what pings: timer, an edge on pin1 or pin2 of the device, or command (cmd/ping)"
    )
    ping_rate_hz: float = option(
        0.0, "pings a second of the timer; 0 for as fast as it goes", low=0, high=100
    )
    take_turns: str = option(
        "", "sonars with the same word here ping one after the other, so as not to hear each other"
    )
    queue_size: int = option(
        2, "pings that may wait to be processed; a live sonar drops the oldest", low=1, high=64
    )
    max_pings: int = option(0, "end after so many pings heard; 0 for never", low=0)

    @property
    def air(self) -> Air:
        """What the sound goes through."""
        return Air(self.temperature_c, self.humidity_percent)

    def settings(self) -> Settings:
        """Return what the sonar is configured with.

        Raises
        ------
        SettingsError
            If the device would not accept it.
        """
        c = self.chirp
        chirp = Chirp(c.kind, c.f_start_hz, c.f_stop_hz, c.duration_s, c.ramp, c.dac_rate_hz)
        pins = {"pin1": 1, "pin2": 2}
        trigger = ExternalTrigger(pins[self.ping_on]) if self.ping_on in pins else None
        return Settings(chirp=chirp, num_words=self.num_words, external_trigger=trigger)

    def to_json(self) -> dict[str, Any]:
        """Return the effective values, as served on Zenoh."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, slots=True)
class Config(SonarConfig):
    """All of it. What is said of the sonar holds for each of ``sonars``, unless it says else."""

    zenoh: ZenohConfig = section(ZenohConfig, "how to reach the network")
    ros2: Ros2Config = section(Ros2Config, "messages for ROS 2; needs the extra 'ros2', no ROS")
    prometheus: PrometheusConfig = section(PrometheusConfig, "counters for Prometheus")
    sonars: Mapping[str, SonarConfig] = field(
        default_factory=dict,
        metadata={
            "doc": "several sonars, by name: each with the keys above that it has of its own, as\n"
            "sonars: {front: {device: {address: 'serial:sn=1'}, ping_rate_hz: 5}, rear: {...}}"
        },
    )

    def each_sonar(self) -> tuple[SonarConfig, ...]:
        """The sonars; without ``sonars`` it is the one described."""
        if self.sonars:
            return tuple(self.sonars.values())
        names = [spec.name for spec in dataclasses.fields(SonarConfig)]
        return (SonarConfig(**{name: getattr(self, name) for name in names}),)


def example_yaml(config: Config | None = None) -> str:
    """Write a configuration, or the defaults, as commented YAML that reads back equal."""
    return write_yaml(config or Config())
