"""A ROS 2 node by pyzeros, which shares no code with ours: prints what it gets, JSON Lines.

pyzeros_peer.py PORT DOMAIN, in a virtual environment of its own.
"""

# Annotations stay objects: cyclonedds_idl cannot resolve them as text.
import asyncio
import json
import struct
import sys
from dataclasses import dataclass, field

import pyzeros
import zenoh
from pyzeros.sub import RawSub
from pyzeros.utils import rmw_zenoh_gid
from ros2_pyterfaces.cyclone import all_msgs as ros
from ros2_pyterfaces.cyclone import idl

PORT, DOMAIN = sys.argv[1:]
WAIT_S = 20.0


@dataclass
class ObjectHypothesis(idl.IdlStruct, typename="vision_msgs/msg/ObjectHypothesis"):
    class_id: str = ""
    score: idl.types.float64 = 0.0


@dataclass
class ObjectHypothesisWithPose(idl.IdlStruct, typename="vision_msgs/msg/ObjectHypothesisWithPose"):
    hypothesis: ObjectHypothesis = field(default_factory=ObjectHypothesis)
    pose: ros.PoseWithCovariance = field(default_factory=ros.PoseWithCovariance)


@dataclass
class BoundingBox3D(idl.IdlStruct, typename="vision_msgs/msg/BoundingBox3D"):
    center: ros.Pose = field(default_factory=ros.Pose)
    size: ros.Vector3 = field(default_factory=ros.Vector3)


@dataclass
class Detection3D(idl.IdlStruct, typename="vision_msgs/msg/Detection3D"):
    header: ros.Header = field(default_factory=ros.Header)
    results: idl.types.sequence[ObjectHypothesisWithPose] = field(default_factory=list)
    bbox: BoundingBox3D = field(default_factory=BoundingBox3D)
    id: str = ""


@dataclass
class Detection3DArray(idl.IdlStruct, typename="vision_msgs/msg/Detection3DArray"):
    header: ros.Header = field(default_factory=ros.Header)
    detections: idl.types.sequence[Detection3D] = field(default_factory=list)


def open_session() -> zenoh.Session:
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": [f"tcp/127.0.0.1:{PORT}"],
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def say(**what) -> None:
    print(json.dumps(what), flush=True)


def place(pose) -> list[float]:
    p, q = pose.position, pose.orientation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def time_ns(header) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def detections(message: Detection3DArray) -> dict:
    return {
        "time_ns": time_ns(message.header),
        "frame_id": message.header.frame_id,
        "detections": [
            {
                "id": one.id,
                "classes": [[r.hypothesis.class_id, r.hypothesis.score] for r in one.results],
                "pose": place(one.results[0].pose.pose),
                "covariance": [float(v) for v in one.results[0].pose.covariance],
                "size": [one.bbox.size.x, one.bbox.size.y, one.bbox.size.z],
            }
            for one in message.detections
        ],
    }


def diagnostics(message: ros.DiagnosticArray) -> dict:
    (status,) = message.status
    level = status.level if isinstance(status.level, int) else status.level[0]
    values = {pair.key: pair.value for pair in status.values}
    return {"level": level, "name": status.name, "message": status.message, "values": values}


def pose(message: ros.PoseStamped) -> dict:
    return {"time_ns": time_ns(message.header), "pose": place(message.pose)}


TOPICS = {
    "/robot1/t/detections": (Detection3DArray, detections),
    "/diagnostics": (ros.DiagnosticArray, diagnostics),
    "/robot1/detected_dock_pose": (ros.PoseStamped, pose),
}


def publishers_gids(session: zenoh.Session) -> dict[str, str]:
    """By topic: what pyzeros makes the publisher's name, from the token that it sees."""
    tokens = [str(r.ok.key_expr) for r in session.liveliness().get(f"@ros2_lv/{DOMAIN}/**") if r.ok]
    found = (token for token in tokens if token.split("/")[5] == "MP")
    return {token.split("/")[9].replace("%", "/"): rmw_zenoh_gid(token).hex() for token in found}


async def main(session: zenoh.Session) -> None:
    loop = asyncio.get_running_loop()
    got: asyncio.Queue = asyncio.Queue()

    def take(topic: str):
        return lambda sample: loop.call_soon_threadsafe(got.put_nowait, (topic, sample))

    subscribers = [RawSub(kind, topic, take(topic)) for topic, (kind, _) in TOPICS.items()]
    say(ready=True)
    waiting = set(TOPICS)
    try:
        while waiting:
            topic, sample = await asyncio.wait_for(got.get(), WAIT_S)
            if topic in waiting:
                tell(topic, sample)
            waiting.discard(topic)
        say(gids=publishers_gids(session))
    finally:  # or the process would never end
        for subscriber in subscribers:
            subscriber.close()


def tell(topic: str, sample: zenoh.Sample) -> None:
    kind, show = TOPICS[topic]
    # Not by pyzeros's own Attachment, which compiles C when it is first used.
    sequence, _, length, gid = struct.unpack("<qqB16s", sample.attachment.to_bytes())
    assert length == len(gid)
    say(
        topic=topic,
        sequence=sequence,
        gid=gid.hex(),
        message=show(kind.deserialize(sample.payload.to_bytes())),
    )


with (
    open_session() as session,
    pyzeros.auto_context(node="listener", zenoh_session=session, domain_id=DOMAIN),
):
    asyncio.run(main(session))
