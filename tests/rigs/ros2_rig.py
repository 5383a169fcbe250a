"""A Zenoh router, and a node of ours on it."""

import contextlib
import json
import socket
import time

import zenoh

from ertis_daemon.events import LandmarkEvent, LandmarkReport
from ertis_daemon.ros2.config import Ros2Config
from ertis_daemon.ros2.node import RosNode
from ertis_daemon.ros2.publisher import Ros2Publisher
from ertis_daemon.zenoh_session import session_config

DOMAIN = 77


INFO = {"address": "serial:sn=1"}
MOUNTED = INFO | {
    "transform": {
        "parent_frame_id": "base_link",
        "child_frame_id": "sonar",
        "translation_m": [0.2, 0.0, 0.5],
        "rotation_xyzw": [0.0, 0.0, 0.7071067811865476, 0.7071067811865476],
    }
}


def report(track_id=1, state="update", **changes):
    values = {
        "label": "r48",
        "probabilities": {"r48": 0.95, "r58": 0.03, "none": 0.02},
        "range_m": 2.0,
        "azimuth_rad": 0.2,
        "elevation_rad": 0.1,
        "covariance": ((1e-4, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 4e-3)),
        "snr_db": 20.0,
        "radius_m": 0.048,
    }
    return LandmarkReport(track_id=track_id, state=state, **(values | changes))


def landmark_event(*reports, time_ns=None):
    return LandmarkEvent(
        schema="ertis.landmarks/1",
        device="t",
        ping_index=3,
        ping_time_ns=time.time_ns() if time_ns is None else time_ns,
        time_uncertainty_ns=0,
        frame_id="sonar",
        source="sim",
        model="m",
        landmarks=reports or (report(),),
        speed_of_sound_m_s=343.2,
        temperature_c=20.0,
    )


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def open_router():
    """As rmw_zenohd is: others find each other by it. Its port."""
    port = free_port()
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
        "connect/endpoints": [],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield port


@contextlib.contextmanager
def ros2_publisher(port, info=INFO, environ=None, **config):
    settings = {"domain_id": DOMAIN, "namespace": "/robot1", "dock_class": "r48"} | config
    session = session_config("peer", [f"tcp/127.0.0.1:{port}"], ["tcp/127.0.0.1:0"])
    with RosNode(Ros2Config(enabled=True, **settings), session, environ or {}) as node:
        yield Ros2Publisher(node, "t", info)
