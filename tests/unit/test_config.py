import dataclasses
import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_daemon.config import (
    ChirpConfig,
    Config,
    ConfigError,
    DeviceConfig,
    ZenohConfig,
    example_yaml,
    load_config,
    parse_config,
)
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
    config = Config(device=DeviceConfig(address=text))
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


def test_sound_is_faster_in_warm_air():
    assert math.isclose(Config().speed_of_sound_m_s, 343.2, abs_tol=0.1)
    assert Config(temperature_c=0.0).speed_of_sound_m_s == 331.3
