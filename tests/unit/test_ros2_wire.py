import struct

import pytest
import zenoh

from ertis_daemon.config_read import parse_config
from ertis_daemon.ros2 import environment, wire
from ertis_daemon.ros2.config import Ros2Config
from ertis_daemon.yaml_nodes import ConfigError
from ertis_daemon.zenoh_session import PublisherError, any_port, session_config

KIND = wire.MessageKind("vision_msgs/msg/Detection3DArray", "RIHS01_79")
NODE = wire.Node(0, "a1b2", 0, "/robot1", "ertis")


def test_keys_and_tokens_are_spelt_as_rmw_zenoh_spells_them():
    dds = "vision_msgs::msg::dds_::Detection3DArray_"
    assert NODE.data_key("/robot1/t/detections", KIND) == f"0/robot1/t/detections/{dds}/RIHS01_79"
    assert NODE.token == "@ros2_lv/0/a1b2/0/0/NN/%/%robot1/ertis"
    assert NODE.publisher_token(3, "/robot1/t/detections", KIND, wire.Qos(10)) == (
        f"@ros2_lv/0/a1b2/0/3/MP/%/%robot1/ertis/%robot1%t%detections/{dds}/RIHS01_79/::,10:,:,:,,"
    )
    root = wire.Node(7, "a1b2", 0, "/", "ertis")
    assert root.token == "@ros2_lv/7/a1b2/0/0/NN/%/%/ertis"


def test_all_of_them_are_keys_that_zenoh_takes():
    token = NODE.publisher_token(3, "/t", KIND, wire.Qos(1, transient_local=True))
    for key in (NODE.token, token, NODE.data_key("/t", KIND)):
        assert str(zenoh.KeyExpr(key)) == key


def test_the_attachment_is_33_bytes_of_sequence_time_and_name():
    name = wire.gid("token")
    data = wire.attachment(5, 1_700_000_000_000_000_000, name)
    assert len(data) == 33
    assert struct.unpack("<qqB", data[:17]) == (5, 1_700_000_000_000_000_000, 16)
    assert data[17:] == name
    # xxHash's own test vector for no input, which it prints from the high end.
    assert wire.gid("")[::-1].hex() == "99aa06d3014798d86001c324468d497f"


@pytest.mark.parametrize(
    ("configured", "environ", "domain"),
    [(-1, {}, 0), (-1, {"ROS_DOMAIN_ID": "42"}, 42), (7, {"ROS_DOMAIN_ID": "42"}, 7)],
)
def test_the_domain_is_the_configured_one_or_that_of_the_environment(configured, environ, domain):
    assert environment.domain_id(configured, environ) == domain


@pytest.mark.parametrize("text", ["-1", "233", "x", "1.0", "٣"])
def test_a_domain_that_is_none_is_refused(text):
    with pytest.raises(PublisherError, match=r"ROS_DOMAIN_ID is .*expected a number from 0 to 232"):
        environment.domain_id(-1, {"ROS_DOMAIN_ID": text})


def described(environ):
    return environment.session_config(session_config("peer", ("tcp/localhost:7447",), ()), environ)


def test_a_session_file_replaces_what_is_configured_and_overrides_come_last(tmp_path):
    file = tmp_path / "session.json5"
    file.write_text('{ mode: "client", timestamping: { enabled: true } }')
    both = {
        "ZENOH_SESSION_CONFIG_URI": str(file),
        "ZENOH_CONFIG_OVERRIDE": 'mode="peer";connect/endpoints=["tcp/robot:7447"]',
    }
    config = described(both)
    assert config.get_json("mode") == '"peer"'
    assert "tcp/robot:7447" in config.get_json("connect/endpoints")
    only = described({"ZENOH_SESSION_CONFIG_URI": str(file)})
    assert only.get_json("mode") == '"client"'
    assert described({}).get_json("connect/endpoints") == '["tcp/localhost:7447"]'


def test_an_environment_that_is_wrong_is_one_line(tmp_path):
    wrong, still = tmp_path / "wrong.json5", tmp_path / "still.json5"
    wrong.write_text("{ mode: ")
    still.write_text('{ mode: "peer" }')
    for environ, words in [
        ({"ZENOH_SESSION_CONFIG_URI": str(tmp_path / "none")}, "No such file"),
        ({"ZENOH_SESSION_CONFIG_URI": str(wrong)}, "wrong.json5"),
        ({"ZENOH_SESSION_CONFIG_URI": str(still)}, "timestamping is off in .*still.json5"),
        ({"ZENOH_CONFIG_OVERRIDE": "mode"}, "'mode', expected key=value"),
        ({"ZENOH_CONFIG_OVERRIDE": "mode=nonsense"}, "mode=nonsense"),
        ({"ZENOH_CONFIG_OVERRIDE": "no/such/key=1"}, "no/such/key"),
    ]:
        with pytest.raises(PublisherError, match=words) as caught:
            described(environ)
        assert "\n" not in str(caught.value)


def read(text):
    return parse_config(f"ros2: {{{text}}}".encode(), "c").ros2


@pytest.mark.parametrize(
    "line",
    [
        "namespace: robot1",
        "namespace: /1robot",
        "namespace: ''",
        "node: a/b",
        "detections_topic: a-b",
        "diagnostics_topic: //x",
        "domain_id: 233",
    ],
)
def test_names_that_ros_does_not_take_are_refused_with_their_line(line):
    with pytest.raises(ConfigError, match="c:1:"):
        read(line)


def test_it_is_off_by_default_and_topics_are_relative_or_absolute():
    assert not Ros2Config().enabled
    read("detections_topic: a/b, diagnostics_topic: '', dock_topic: /dock, namespace: /a/b")


def test_a_session_beside_another_listens_at_the_same_addresses_on_any_port():
    listen = ("tcp/localhost:0", "tcp/127.0.0.1:7447", "tls/[::1]:7448#iface=lo", "unixpipe/x")
    assert any_port(listen) == ("tcp/localhost:0", "tcp/127.0.0.1:0", "tls/[::1]:0#iface=lo")
