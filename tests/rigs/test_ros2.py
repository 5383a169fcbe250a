"""Our ROS 2 node on a real Zenoh network, read by plain Zenoh; test_ros2_peers.py has ROS nodes."""

import json
import os
import struct
import subprocess
import sys
import time

import pytest
import zenoh
from patience import wait_for
from ros2_rig import DOMAIN, MOUNTED, landmark_event, open_router, report, ros2_publisher
from zenoh import ext

from ertis_daemon.ros2 import wire

DEADLINE_S = 10.0
DETECTIONS = f"{DOMAIN}/robot1/t/detections/vision_msgs::msg::dds_::Detection3DArray_/*"
DOCK = f"{DOMAIN}/robot1/detected_dock_pose/**"


@pytest.fixture
def port():
    with open_router() as port:
        yield port


@pytest.fixture
def reader(port):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    with zenoh.open(config) as session:
        yield session


def tokens(reader):
    found = reader.liveliness().get(f"@ros2_lv/{DOMAIN}/**", timeout=3.0)
    return {str(reply.ok.key_expr) for reply in found if reply.ok}


def subscribe(reader, key):
    return reader.declare_subscriber(key, zenoh.handlers.FifoChannel(100))


def hear(subscriber, publish):
    """Publish until something comes."""

    def attempt():
        publish()
        return subscriber.try_recv()

    return wait_for(attempt)


def test_node_and_publishers_are_seen_while_they_live(port, reader):
    with ros2_publisher(port, info=MOUNTED):
        found = wait_for(lambda: (met := tokens(reader)) and len(met) == 5 and met)
        kinds = sorted(token.split("/")[5] for token in found)
        assert kinds == ["MP"] * 4 + ["NN"]
        assert {token.split("/")[9] for token in found if "/MP/" in token} == {
            "%robot1%t%detections",
            "%diagnostics",
            "%robot1%detected_dock_pose",
            "%tf_static",
        }
    wait_for(lambda: not tokens(reader))


def test_each_message_carries_its_number_time_and_publisher(port, reader):
    with ros2_publisher(port) as publisher:
        subscriber = subscribe(reader, DETECTIONS)
        first = hear(subscriber, lambda: publisher.publish(landmark_event()))
        publisher.publish(landmark_event())
        second = wait_for(subscriber.try_recv)
        (token,) = [token for token in tokens(reader) if "%detections" in token]
        before, after = (struct.unpack("<qqB16s", s.attachment.to_bytes()) for s in (first, second))
        assert after[0] == before[0] + 1
        assert 0 <= time.time_ns() - after[1] < 60e9
        assert before[2:] == after[2:] == (16, wire.gid(token))
        assert str(first.encoding) == "application/cdr"
        assert first.payload.to_bytes()[:4] == b"\x00\x01\x00\x00"


def test_a_late_joiner_gets_the_static_transform(port, reader):
    with ros2_publisher(port, info=MOUNTED):
        subscriber = ext.declare_advanced_subscriber(
            reader,
            f"{DOMAIN}/tf_static/**",
            zenoh.handlers.FifoChannel(10),
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )
        assert b"base_link" in wait_for(subscriber.try_recv).payload.to_bytes()


def test_the_dock_is_published_while_it_is_heard_and_no_longer(port, reader):
    with ros2_publisher(port) as publisher:
        subscriber = subscribe(reader, DOCK)
        hear(subscriber, lambda: publisher.publish(landmark_event()))
        time.sleep(0.2)
        while subscriber.try_recv() is not None:
            pass
        publisher.publish(landmark_event(report(1, "lost")))
        publisher.publish(landmark_event(time_ns=time.time_ns() - 2_000_000_000))
        publisher.publish(landmark_event(report(2, label="r70")))
        publisher.publish_status({"pings_heard": 1})
        time.sleep(0.5)
        assert subscriber.try_recv() is None


def test_without_a_dock_class_diagnostics_topic_or_transform_there_is_one_publisher(port, reader):
    with ros2_publisher(port, dock_class="", diagnostics_topic="") as publisher:
        publisher.publish_status({"pings_heard": 1})
        assert len(wait_for(lambda: (met := tokens(reader)) and len(met) == 2 and met)) == 2


def test_a_sonar_that_leaves_takes_its_topics_along_and_leaves_the_node(port, reader):
    with ros2_publisher(port) as publisher:
        wait_for(lambda: len(tokens(reader)) == 4)
        publisher.close()
        publisher.close()
        assert wait_for(lambda: (met := tokens(reader)) and len(met) == 1 and met)


def test_another_sonar_does_not_look_for_the_dock(port, reader):
    with ros2_publisher(port, dock_sonar="front"):
        found = wait_for(lambda: (met := tokens(reader)) and len(met) == 3 and met)
        assert not any("dock" in token for token in found)


def test_ros_users_may_name_network_and_domain_in_the_environment(port, reader):
    environ = {
        "ROS_DOMAIN_ID": str(DOMAIN),
        "ZENOH_CONFIG_OVERRIDE": f'connect/endpoints=["tcp/127.0.0.1:{port}"]',
    }
    with ros2_publisher(1, domain_id=-1, environ=environ):
        assert wait_for(lambda: tokens(reader))


def test_zenohs_own_log_is_shown_as_rust_log_asks():
    code = (
        "from ertis_daemon.config import ZenohConfig\n"
        "from ertis_daemon.zenoh_session import Network\n"
        "for _ in range(2):\n"
        "    Network(ZenohConfig(connect=(), listen=('tcp/127.0.0.1:0',))).close()\n"
    )
    said = {}
    for level in ("", "zenoh=info"):
        done = subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "RUST_LOG": level},
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
        said[level] = done.stdout + done.stderr
    assert "tcp/127.0.0.1" in said["zenoh=info"]
    assert said[""] == ""


def run_daemon(tmp_path, config, *, without=""):
    path = tmp_path / "ertis.yaml"
    path.write_text(config)
    hide = f"import sys; sys.modules[{without!r}] = None; " if without else ""
    code = f"{hide}import sys; from ertis_daemon.cli import main; sys.exit(main())"
    return subprocess.Popen(
        [sys.executable, "-c", code, "run", "--config", str(path), "--max-pings", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


SCENE = "device: {name: t, address: 'sim:%s'}\n"


@pytest.fixture
def scene():
    import ertis_simulator

    (path,) = (f"{folder}/scenes/demo.yaml" for folder in ertis_simulator.__path__)
    return SCENE % path


def test_the_daemon_publishes_for_ros_when_told_to(port, reader, scene, tmp_path):
    subscriber = subscribe(reader, f"{DOMAIN}/diagnostics/**")
    network = f"zenoh: {{connect: [tcp/127.0.0.1:{port}]}}\n"
    ros = f"ros2: {{enabled: true, domain_id: {DOMAIN}}}\n"
    process = run_daemon(tmp_path, scene + network + ros)
    try:
        _, error = process.communicate(timeout=60)
        assert process.returncode == 0, error
        assert "ROS 2: node /ertis in domain 77" in error
        assert b"ertis: t" in wait_for(subscriber.try_recv).payload.to_bytes()
    finally:
        process.kill()
        process.communicate()


def test_the_daemon_says_what_to_install_for_ros(scene, tmp_path):
    process = run_daemon(tmp_path, scene + "ros2: {enabled: true}\n", without="rosbags.typesys")
    _, error = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "rosbags is not installed: pip install 'ertis[ros2]'" in error.splitlines()[-1]
