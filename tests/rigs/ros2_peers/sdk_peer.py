"""A ROS 2 node by zenoh-ros2-sdk: lists topics and gets messages, printed as JSON Lines.

sdk_peer.py PORT DOMAIN DEFINITIONS, in a virtual environment of its own. DEFINITIONS is a JSON
file of message definitions and hashes, for the SDK would fetch them with git.
"""

from __future__ import annotations

import json
import queue
import sys
import time
from dataclasses import asdict
from pathlib import Path

from zenoh_ros2_sdk import ROS2Subscriber
from zenoh_ros2_sdk.discovery import get_topic_info, get_topic_names_and_types
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

PORT, DOMAIN, KINDS = int(sys.argv[1]), int(sys.argv[2]), json.loads(Path(sys.argv[3]).read_text())
WAIT_S = 20.0
TOPICS = {
    "/robot1/t/detections": "vision_msgs/msg/Detection3DArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/robot1/detected_dock_pose": "geometry_msgs/msg/PoseStamped",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}


def say(**what) -> None:
    print(json.dumps(what, default=lambda value: value.tolist()), flush=True)


def look() -> None:
    """What ``ros2 topic list -t`` and ``ros2 topic info -v`` would say."""
    deadline = time.monotonic() + WAIT_S
    names: dict = {}
    while not set(TOPICS) <= set(names) and time.monotonic() < deadline:
        names = dict(get_topic_names_and_types(DOMAIN, "127.0.0.1", PORT))
    say(topics=names)
    for topic in TOPICS:
        info = get_topic_info(topic, DOMAIN, "127.0.0.1", PORT, verbose=True)
        if info is not None:
            say(info=topic, publishers=[asdict(endpoint) for endpoint in info.publishers])


def listen() -> None:
    got: queue.Queue = queue.Queue()
    subscribers = []
    for topic, kind in TOPICS.items():
        late = (
            QosProfile(durability=QosDurability.TRANSIENT_LOCAL) if topic == "/tf_static" else None
        )
        subscribers.append(
            ROS2Subscriber(
                topic,
                kind,
                lambda message, topic=topic: got.put((topic, message)),
                msg_definition=KINDS[kind]["definition"],
                type_hash=KINDS[kind]["hash"],
                domain_id=DOMAIN,
                router_port=PORT,
                qos=late,
            )
        )
    say(ready=True)
    waiting = set(TOPICS)
    try:
        while waiting:
            topic, message = got.get(timeout=WAIT_S)
            if topic in waiting:
                say(topic=topic, message=asdict(message))
            waiting.discard(topic)
    finally:  # or the process would never end
        for subscriber in subscribers:
            subscriber.close()
        subscribers[0].session_mgr.session.close()


look()
listen()
