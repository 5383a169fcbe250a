"""The channels of a recording: topics, encodings, schemas; and what viewers are shown."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.records import Channel

from ertis_driver import foxglove
from ertis_driver.codec import PLAIN, PLANES
from ertis_driver.geometry import EMITTER_POSITION_M
from ertis_driver.mcap_writer import McapWriter
from ertis_driver.recording_info import RecordingInfo

FRAME_ID = "sonar"  # x forward, y left, z up, origin at the mean of the microphones
EVENT_SCHEMA_NAME = "ertis.landmarks"
FRAME_LAYOUTS = {
    PLAIN: b"""\
A ping as the eRTIS sends it; every field is a little-endian uint32:
header 0x51534E12, ping index, N PDM words, footer 0x2F418672.
Bit m of word n is microphone m's PDM bit, n / pdm_rate_hz s after the start.
""",
    PLANES: b"""\
A ping without its framing: little-endian uint32 ping index and number of PDM words N, then zstd of
4 N bytes: 32 rows of N / 32 little-endian uint32. Bit b of word k in row m is bit m of
words[32 k + b] XOR words[32 k + b - 1], where words[-1] is 0: microphone m's PDM bit changed.
""",
}
PING_SCHEMA = {
    "type": "object",
    "properties": {
        "ping_index": {"type": "integer", "minimum": 0},
        "active": {"type": "boolean", "description": "a chirp was emitted"},
        "time_uncertainty_ns": {"type": "integer", "minimum": 0},
        "clock_step_ns": {"type": "integer", "description": "host clock set since the last ping"},
        "temperature_c": {"type": ["number", "null"]},
        "humidity_percent": {"type": ["number", "null"]},
    },
    "required": ["ping_index", "active", "time_uncertainty_ns", "temperature_c"],
}
_VIEWED = {
    "picture": "foxglove.CompressedImage",
    "detections": "foxglove.PointCloud",
    "truth/points": "foxglove.PointCloud",
    "microphones": "foxglove.PointCloud",
    "log": "foxglove.Log",
    "tf": "foxglove.FrameTransforms",
}


def make_channels(
    writer: McapWriter, *, frame_encoding: str, event_schema: bytes
) -> dict[str, Channel]:
    """Every channel that a recording may have, by topic; unused ones cost a line in its summary."""
    schemas = {
        "ping": ("ertis.Ping", json.dumps(PING_SCHEMA).encode()),
        "truth": ("ertis.Truth", b'{"type": "object"}'),
        "events": (EVENT_SCHEMA_NAME, event_schema),
    }
    layout = ("ertis.Frame", "text", FRAME_LAYOUTS[frame_encoding])
    channels = {"pdm": writer.add_channel("pdm", frame_encoding, layout)}
    for topic, (name, data) in schemas.items():
        channels[topic] = writer.add_channel(topic, "json", (name, "jsonschema", data))
    for topic, name in _VIEWED.items():
        channels[topic] = writer.add_channel(topic, "protobuf", foxglove.schema(name))
    return channels


def layout_messages(info: RecordingInfo, time_ns: int) -> dict[str, bytes]:
    """What a viewer is told once: where the microphones and the emitter are."""
    mics = np.array(info.mic_positions_m, np.float32)
    emitter = (FRAME_ID, "emitter", EMITTER_POSITION_M, (0.0, 0.0, 0.0, 1.0))
    return {
        "microphones": foxglove.point_cloud(time_ns, FRAME_ID, "xyz", mics),
        "tf": foxglove.transforms(time_ns, [emitter]),
    }


def landmark_points(items: Any, time_ns: int) -> bytes | None:
    """A point cloud of landmarks, of events or of truth; None if they have no places.

    Parameters
    ----------
    items
        Each with ``range_m``, ``azimuth_rad``, ``elevation_rad``, and ``track_id`` perhaps.
    """
    points = _points(items)
    if points is None:
        return None
    names = ("x", "y", "z", "radius_m", "track_id")
    return foxglove.point_cloud(time_ns, FRAME_ID, names, points)


def _points(items: Any) -> npt.NDArray[np.float32] | None:
    if not isinstance(items, Iterable) or isinstance(items, str | Mapping):
        return None
    rows = []
    for item in items:
        try:
            where = [float(item[n]) for n in ("range_m", "azimuth_rad", "elevation_rad")]
            more = [float(item.get(n) or 0.0) for n in ("radius_m", "track_id")]
        except (TypeError, ValueError, KeyError, AttributeError):
            continue
        range_m, azimuth, elevation = where
        flat = range_m * math.cos(elevation)
        xyz = [flat * math.cos(azimuth), flat * math.sin(azimuth), range_m * math.sin(elevation)]
        rows.append([*xyz, *more])
    return np.array(rows, np.float32).reshape(-1, 5)
