import dataclasses
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_daemon.config import (
    ChirpConfig,
    Config,
    DeviceConfig,
    RecordConfig,
    SonarConfig,
    ZenohConfig,
    example_yaml,
)
from ertis_daemon.config_read import load_config, parse_config
from ertis_daemon.layers import Sources
from ertis_daemon.yaml_nodes import ConfigError
from ertis_detector.air import Air
from ertis_driver.device import Settings


def errors_of(text):
    with pytest.raises(ConfigError) as caught:
        parse_config(text.encode(), "x.yaml")
    return str(caught.value).splitlines()


def test_an_empty_file_means_all_defaults():
    assert parse_config(b"") == Config()
    assert parse_config(b"# only a comment\nchirp:\n  # nothing\n") == Config()
    assert Config().settings() == Settings()


def test_the_example_names_every_field_and_reads_back_equal():
    assert parse_config(example_yaml().encode()) == Config()
    other = Config(
        device=DeviceConfig(name="it's", address="replay:a b: #c.mcap", frame_id="on"),
        chirp=ChirpConfig(kind="linear", f_start_hz=50e3),
        zenoh=ZenohConfig(mode="client", connect=(), listen=("tcp/[::1]:0", "udp/0.0.0.0:1")),
        ping_rate_hz=1e-3,
    )
    assert parse_config(example_yaml(other).encode()) == other
    for section in dataclasses.fields(Config):
        assert f"\n{section.name}:" in "\n" + example_yaml()


@given(st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1))
def test_any_printable_text_survives_the_example(text):
    config = Config(device=DeviceConfig(frame_id=text))
    assert parse_config(example_yaml(config).encode()) == config


def test_numbers_are_read_as_the_field_wants_them_not_as_yaml_does():
    config = parse_config(b"chirp: {f_start_hz: 4.5e4}\ndevice: {name: on, frame_id: 1:30}\n")
    assert config.chirp.f_start_hz == 45_000.0  # text to YAML 1.1
    assert config.device == DeviceConfig(name="on", frame_id="1:30")  # True and 90 to YAML 1.1


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("max_pings: 010", "12: max_pings: '010' is octal to some"),
        ("max_pings: 1.5", "12: max_pings: '1.5', expected a whole number"),
        ("ping_rate_hz: 1:30", "15: ping_rate_hz: '1:30', expected a finite number"),
        ("ping_rate_hz: .nan", "15: ping_rate_hz: '.nan', expected a finite number"),
        ("ping_rate_hz: 1e999", "15: ping_rate_hz: '1e999', expected a finite number"),
        ("ping_rate_hz: -1", "15: ping_rate_hz: -1.0, expected 0 to 100"),
        ("temperature_c:", "15: temperature_c: no value"),
        ("temperature_c: [20]", "16: temperature_c: expected one value"),
        ("chirp: 3", "8: chirp: expected 'key: value' lines"),
        ("chirp: {kind: square}", "15: chirp.kind: 'square', expected one of hyperbolic, linear"),
        ("chirp: {f_start_hz: 3e5}", "1: chirp: chirp start frequency"),
        ("num_words: 1000", "1: num_words: num_words 1000, expected a multiple"),
        ("device: {name: a/b}", "16: device.name: 'a/b', expected a Zenoh key chunk"),
        ("device: {name: 'a b'}", "16: device.name: 'a b', expected a Zenoh key chunk"),
        ("device: {address: ''}", "19: device.address: empty"),
        ("device: {address: 'foo:bar'}", "19: device.address: address 'foo:bar' is of unknown"),
        ("device: {address: /dev/ttyACM0}", "19: device.address: address '/dev/ttyACM0', expected"),
        ("zenoh: {connect: tcp/a:1}", "18: zenoh.connect: expected a list"),
        ("zenoh: {connect: [localhost]}", "18: zenoh.connect: 'localhost', expected a Zenoh loc"),
        ("odometry: {key: /odom}", "17: odometry.key: '', expected a Zenoh key chunk"),
        ("odometry: {key: a//b}", "17: odometry.key: '', expected a Zenoh key chunk"),
        ("odometry: {key: robot/*}", "17: odometry.key: '*', expected a Zenoh key chunk"),
        ("tracker: {max_false_events_per_hour: 0}", "38: tracker.max_false_events_per_hour: 0.0"),
        ("&a x: 1", "1: x: unknown key"),
        ("device: !!python/name:os.system ''", "9: tags are not allowed"),
        ("a: [b", "6: expected ',' or ']'"),
        ("- 1", "1: expected 'key: value' lines"),
        ("? [a]\n: 1", "3: ?: unknown key"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(line, expected):
    assert errors_of(line)[0].split(":", 2)[2].startswith(expected)


def test_every_error_is_listed_in_the_order_of_its_line():
    text = "chirp:\n  duraton: 4\n  ramp: 2\nmax_pings: 1\nmax_pings: 2\nqueue_size: x\n"
    assert errors_of(text) == [
        "x.yaml:2:3: chirp.duraton: unknown key, did you mean 'duration_s'?",
        "x.yaml:3:9: chirp.ramp: 2.0, expected 0 to 0.5",
        "x.yaml:5:1: max_pings: given twice, first in line 4",
        "x.yaml:6:13: queue_size: 'x', expected a whole number",
    ]


def test_a_bomb_of_aliases_a_deep_nest_and_a_huge_file_are_refused():
    assert "aliases are not allowed" in errors_of("a: &a [1]\nb: [*a, *a]\n")[0]
    assert "nested deeper" in errors_of("a: " + "[" * 5000)[0]
    assert "larger than" in errors_of("#" * 70_000)[0]
    assert "UTF-8" in errors_of("a: \x00")[0]


@given(st.binary(max_size=200))
def test_any_bytes_give_a_configuration_or_a_config_error(data):
    with suppress(ConfigError):
        parse_config(data)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: No such file"):
        load_config(tmp_path / "none.yaml")


def test_the_air_is_as_configured():
    assert Config().air == Air(20.0, 50.0)
    assert Config(temperature_c=0.0, humidity_percent=80.0).air == Air(0.0, 80.0)


TWO = b"""\
device: {name: robot, frame_id: head}
temperature_c: 25
zenoh: {commands: true}
sonars:
  front:
    device: {address: 'serial:sn=1'}
  rear:
    device: {address: 'usb:sn=2', frame_id: tail}
    temperature_c: 5
    ping_on: command
    pose: {parent_frame: base_link, x_m: -0.3, yaw_deg: 180}
"""


def test_a_sonar_is_as_all_are_but_for_what_it_says_itself():
    config = parse_config(TWO)
    front, rear = config.each_sonar()
    assert (front.device.name, rear.device.name) == ("front", "rear")
    assert (front.device.frame_id, rear.device.frame_id) == ("front_sonar", "tail")
    assert (front.temperature_c, rear.temperature_c) == (25, 5)
    assert (front.ping_on, rear.ping_on) == ("timer", "command")
    assert rear.pose.yaw_deg == 180
    assert parse_config(example_yaml(config).encode()) == config


def test_without_sonars_the_one_described_is_all_there_is():
    (sonar,) = parse_config(b"device: {name: me}\nqueue_size: 5\n").each_sonar()
    assert type(sonar) is SonarConfig
    assert (sonar.device.name, sonar.queue_size) == ("me", 5)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sonars: [a]", "x.yaml:1:9: sonars: expected 'name:' lines"),
        ("sonars: {a/b: {}}", "x.yaml:1:10: sonars: 'a/b', expected a Zenoh key chunk"),
        (
            "sonars: {a: {device: {name: b}}}",
            "x.yaml:1:23: sonars.a.device.name: 'b', but its key is its name",
        ),
        ("sonars: {a: 3}", "x.yaml:1:13: sonars.a: expected 'key: value' lines"),
        ("sonars: {a: {zenoh: {}}}", "x.yaml:1:14: sonars.a.zenoh: unknown key"),
        ("sonars: {a: {chirp: {ramp: 2}}}", "x.yaml:1:28: sonars.a.chirp.ramp: 2.0, expected 0 to"),
        ("sonars: {a: {}, a: {}}", "x.yaml:1:17: sonars.a: given twice, first in line 1"),
        ("ping_on: command", "x.yaml:1:1: ping_on: command, which needs zenoh.commands: true"),
        ("record: {on: [new, old]}", "x.yaml:1:14: record.on: 'old', expected one of new, lost"),
        (
            "prometheus: {listen: 9464}",
            "x.yaml:1:22: prometheus.listen: '9464', expected HOST:PORT",
        ),
        (
            "device: {address: 'usb:sn=1'}\nsonars: {a: {}, b: {}}",
            "x.yaml:2:17: sonars.b: the same device.address as 'a' has",
        ),
    ],
)
def test_what_is_wrong_with_several_sonars_is_said_once_with_its_place(text, expected):
    (line,) = errors_of(text)
    assert line.startswith(expected)


def test_an_error_in_what_all_sonars_share_is_said_once():
    assert errors_of("queue_size: 0\ndevice: {address: 'sim:x'}\nsonars: {a: {}, b: {}}") == [
        "x.yaml:1:13: queue_size: 0, expected 1 to 64"
    ]


@pytest.fixture
def layered(tmp_path):
    """Files of the machine, of the user and on the command line; a function that reads them."""

    def load(system="", user="", named=None, environment=None, flags=None):
        (tmp_path / "ertis").mkdir(exist_ok=True)
        (tmp_path / "system.yaml").write_text(system)
        (tmp_path / "ertis/ertis.yaml").write_text(user)
        if named is not None:
            (tmp_path / "named.yaml").write_text(named)
        sources = Sources(
            file=None if named is None else tmp_path / "named.yaml",
            flags=flags,
            system_file=tmp_path / "system.yaml",
            environment={"XDG_CONFIG_HOME": str(tmp_path), **(environment or {})},
        )
        return sources.load()

    load.folder = tmp_path
    return load


def test_each_layer_wins_over_the_one_before_key_by_key(layered):
    config = layered(
        system="device: {name: a, address: 'sim:a'}\nqueue_size: 1\nmax_pings: 1\nnum_words: 32768",
        user="device: {name: b}\nqueue_size: 2\nmax_pings: 2",
        named="queue_size: 3\nmax_pings: 3",
        environment={"ERTIS_QUEUE_SIZE": "4", "ERTIS_MAX_PINGS": "8", "HOME": "/nowhere"}
        | {"ERTIS_DEVICE__FRAME_ID": "on", "ERTIS_ZENOH__CONNECT": "[tcp/a:1, tcp/b:2]"},
        flags={"max_pings": "9"},
    )
    assert config.device == DeviceConfig(name="b", address="sim:a", frame_id="on")
    assert (config.num_words, config.queue_size, config.max_pings) == (32_768, 4, 9)
    assert config.zenoh.connect == ("tcp/a:1", "tcp/b:2")


def test_no_layer_at_all_is_all_defaults(tmp_path):
    nowhere = Sources(system_file=tmp_path / "none", environment={})
    assert nowhere.load() == Config()
    assert nowhere.files() == ()


def test_the_sonars_of_a_later_file_are_all_there_are(layered):
    config = layered(
        system="sonars: {a: {}, b: {}}",
        named="sonars: {c: {queue_size: 3}}",
        environment={"ERTIS_SONARS__C__MAX_PINGS": "7"},
    )
    assert [(s.device.name, s.queue_size, s.max_pings) for s in config.each_sonar()] == [
        ("c", 3, 7)
    ]
    assert layered(system="sonars: {a: {}}", named="sonars: {}").sonars == {}


def test_errors_of_all_layers_are_told_together_each_with_its_own_place(layered):
    with pytest.raises(ConfigError) as caught:
        layered(
            system="queue_size: 2\nqueue_size: 1\n",
            named="chirp:\n  ramp: x\n",
            environment={"ERTIS_DEVICE__NAM": "x", "ERTIS_MAX_PINGS": "two"},
            flags={"device.name": "a/b"},
        )
    folder = layered.folder
    assert sorted(str(caught.value).splitlines()) == sorted(
        [
            "command line: device.name: 'a/b', expected a Zenoh key chunk: not empty, no / * ? # $ "
            "@ and no blanks",
            f"{folder}/named.yaml:2:9: chirp.ramp: 'x', expected a finite number",
            f"{folder}/system.yaml:2:1: queue_size: given twice, first in line 1",
            "environment: ERTIS_DEVICE__NAM: device.nam: unknown key, did you mean 'name'?",
            "environment: ERTIS_MAX_PINGS: max_pings: 'two', expected a whole number",
        ]
    )


def test_a_file_that_is_named_must_exist(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: No such file"):
        Sources(file=tmp_path / "none.yaml", environment={}).load()


def test_a_broken_list_in_the_environment_is_one_line(layered):
    with pytest.raises(ConfigError, match="environment: ERTIS_ZENOH__CONNECT") as caught:
        layered(environment={"ERTIS_ZENOH__CONNECT": "[a"})
    assert "\n" not in str(caught.value)


def test_record_settings_reach_their_section():
    config = parse_config(b"record: {on: [new, dead], before_s: 0.5}\n")
    assert config.record == RecordConfig(on=("new", "dead"), before_s=0.5)


def test_a_home_that_may_not_be_looked_into_is_no_error(tmp_path):
    environment = {"XDG_CONFIG_HOME": str(tmp_path / ("x" * 300))}  # as useless to any user
    assert Sources(system_file=tmp_path / "none", environment=environment).load() == Config()


def test_an_address_that_is_refused_is_not_taken_for_its_default_too():
    text = "sonars:\n  a: {}\n  b: {device: {address: 'foo:bar'}}\n"
    [line] = errors_of(text)
    assert "'foo:bar' is of unknown kind" in line
