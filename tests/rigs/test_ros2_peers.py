"""Two ROS 2 nodes that others wrote, in pure Python, see ours and understand its messages.

No genuine ROS 2 node is among them: docs/ros2.md says how to look with one.
"""

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from ros2_rig import DOMAIN, MOUNTED, landmark_event, open_router, ros2_publisher

from ertis_daemon.ros2 import messages

pytestmark = [pytest.mark.index, pytest.mark.slow]  # half a minute, and an installation
HERE = Path(__file__).parent / "ros2_peers"
REQUIREMENTS = Path(__file__).parents[1] / "ros2_peers.txt"
INSTALL_S = 300
WAIT_S = 60

# From ROS's own generator, not from ours.
HASHES = {
    "vision_msgs/msg/Detection3DArray": (
        "RIHS01_793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": (
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    ),
}


@pytest.fixture(scope="module")
def peers_python(request):
    """A Python that has both peers, in a virtual environment kept in pytest's cache."""
    if sys.version_info < (3, 11):
        pytest.skip("pyzeros needs Python 3.11 or newer")
    name = f"{REQUIREMENTS.stem}-{sys.version_info.major}.{sys.version_info.minor}"
    folder = request.config.cache.mkdir(name) / "venv"
    done = folder / "done"
    python = folder / "bin" / "python"
    if done.exists() and done.read_text() == REQUIREMENTS.read_text():
        return python
    install = [str(python), "-m", "pip", "install", "--quiet", "-r", str(REQUIREMENTS)]
    try:
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
        subprocess.run(install, check=True, capture_output=True, text=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"the package index did not deliver the peers within {INSTALL_S} s")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no package index, or not these peers in it: {str(error.stderr)[-300:]}")
    done.write_text(REQUIREMENTS.read_text())
    return python


class Peer:
    """A peer's process; its lines as they come."""

    def __init__(self, python, script, *arguments, cwd):
        environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
        self.process = subprocess.Popen(
            [str(python), str(HERE / script), *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=cwd,  # pyzeros leaves a cache where it runs
        )
        self.lines = []
        self.ready = threading.Event()
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.append(json.loads(line))
            if "ready" in self.lines[-1]:
                self.ready.set()
        self.ready.set()

    def finish(self, publish):
        """Publish until it has heard enough; its lines."""
        deadline = time.monotonic() + WAIT_S
        assert self.ready.wait(WAIT_S)
        while self.process.poll() is None and time.monotonic() < deadline:
            publish()
            time.sleep(0.1)
        return self.lines

    def close(self):
        self.process.kill()
        self._reader.join()
        self.error = self.process.stderr.read()
        self.process.wait()
        for stream in (self.process.stdout, self.process.stderr):
            stream.close()


@pytest.fixture
def hear(peers_python, tmp_path):
    """Runs a peer beside a node of ours: its lines, and the times of the pings published."""
    times_ns = []

    def run(script, *arguments):
        where = {"info": MOUNTED} if script == "sdk_peer.py" else {}
        with open_router() as port, ros2_publisher(port, **where) as publisher:
            peer = Peer(peers_python, script, port, DOMAIN, *arguments, cwd=tmp_path)

            def publish():
                event = landmark_event()
                times_ns.append(event.ping_time_ns)
                publisher.publish(event)
                publisher.publish_status({"pings_heard": 7, "state": "running"})

            try:
                lines = peer.finish(publish)
            finally:
                peer.close()
            assert peer.process.returncode == 0, peer.error[-3000:]
        return lines, times_ns

    return run


def by_topic(lines):
    return {line["topic"]: line for line in lines if "topic" in line}


def test_pyzeros_understands_detections_dock_and_diagnostics_and_knows_who_sent_them(hear):
    lines, times_ns = hear("pyzeros_peer.py")
    heard = by_topic(lines)
    (gids,) = [line["gids"] for line in lines if "gids" in line]
    assert {topic: line["gid"] for topic, line in heard.items()} == gids
    assert all(line["sequence"] >= 1 for line in heard.values())
    found = heard["/robot1/t/detections"]["message"]
    assert found["time_ns"] in times_ns
    assert found["frame_id"] == "sonar"
    (dish,) = found["detections"]
    assert dish["id"] == "1"
    assert dish["classes"] == [["r48", 0.95], ["r58", 0.03]]
    assert dish["size"] == [0.096] * 3
    assert dish["pose"][:3] == pytest.approx([1.9503, 0.3954, 0.1997], abs=1e-3)
    assert dish["covariance"][35] == 9999.0
    dock = heard["/robot1/detected_dock_pose"]["message"]
    assert dock["time_ns"] in times_ns
    assert dock["pose"] == dish["pose"]
    health = heard["/diagnostics"]["message"]
    assert health["name"] == "ertis: t"
    assert health["values"]["pings_heard"] == "7"


def test_the_sdk_lists_our_topics_and_understands_all_four(hear, tmp_path):
    definitions = tmp_path / "definitions.json"
    definitions.write_text(json.dumps(messages_for_the_sdk()))
    lines, _ = hear("sdk_peer.py", definitions)
    (topics,) = [line["topics"] for line in lines if "topics" in line]
    assert topics["/robot1/t/detections"] == ["vision_msgs/msg/Detection3DArray"]
    assert topics["/diagnostics"] == ["diagnostic_msgs/msg/DiagnosticArray"]
    assert topics["/robot1/detected_dock_pose"] == ["geometry_msgs/msg/PoseStamped"]
    assert topics["/tf_static"] == ["tf2_msgs/msg/TFMessage"]
    infos = {line["info"]: line["publishers"] for line in lines if "info" in line}
    (publisher,) = infos["/robot1/t/detections"]
    assert publisher["node_name"].strip("/") == "ertis"
    assert publisher["node_namespace"].strip("/") == "robot1"
    assert publisher["type_hash"] == HASHES["vision_msgs/msg/Detection3DArray"]
    assert publisher["qos"] == "::,10:,:,:,,"
    assert infos["/tf_static"][0]["qos"] == ":1:,1:,:,:,,"
    heard = by_topic(lines)
    (dish,) = heard["/robot1/t/detections"]["message"]["detections"]
    hypothesis = dish["results"][0]["hypothesis"]
    assert (hypothesis["class_id"], hypothesis["score"]) == ("r48", 0.95)
    (transform,) = heard["/tf_static"]["message"]["transforms"]
    assert transform["header"]["frame_id"] == "base_link"
    assert transform["child_frame_id"] == "sonar"
    placed = transform["transform"]["translation"]
    assert (placed["x"], placed["y"], placed["z"]) == (0.2, 0.0, 0.5)


def messages_for_the_sdk():
    return {
        name: {"definition": messages.definition(name), "hash": HASHES.get(name) or our_hash(name)}
        for name in (
            messages.DETECTIONS,
            messages.DIAGNOSTICS,
            messages.POSE,
            messages.TRANSFORMS,
        )
    }


def our_hash(name):
    return messages.kind(name).type_hash
