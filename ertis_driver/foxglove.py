"""Foxglove's schemas for viewers, as protobuf bytes: pictures, log lines, points and frames.

Five messages do not need protobuf's own packages: the wire format is lists of numbered fields. The
numbers are those of https://docs.foxglove.dev/docs/sdk/schemas; tests hold both the schemas and the
bytes against Foxglove's Python package.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

_ENUMS: dict[str, tuple[str, ...]] = {
    "foxglove.Log.Level": ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"),
    "foxglove.PackedElementField.NumericType": (
        *("UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"),
    ),
}
# message -> (number, name, type); a type in brackets is repeated.
_MESSAGES: dict[str, tuple[tuple[int, str, str], ...]] = {
    "google.protobuf.Timestamp": ((1, "seconds", "int64"), (2, "nanos", "int32")),
    "foxglove.Vector3": ((1, "x", "double"), (2, "y", "double"), (3, "z", "double")),
    "foxglove.Quaternion": (
        *((1, "x", "double"), (2, "y", "double"), (3, "z", "double"), (4, "w", "double")),
    ),
    "foxglove.Pose": (
        (1, "position", "foxglove.Vector3"),
        (2, "orientation", "foxglove.Quaternion"),
    ),
    "foxglove.PackedElementField": (
        (1, "name", "string"),
        (2, "offset", "fixed32"),
        (3, "type", "foxglove.PackedElementField.NumericType"),
    ),
    "foxglove.FrameTransform": (
        (1, "timestamp", "google.protobuf.Timestamp"),
        (2, "parent_frame_id", "string"),
        (3, "child_frame_id", "string"),
        (4, "translation", "foxglove.Vector3"),
        (5, "rotation", "foxglove.Quaternion"),
    ),
    "foxglove.FrameTransforms": ((1, "transforms", "[foxglove.FrameTransform]"),),
    "foxglove.CompressedImage": (
        (1, "timestamp", "google.protobuf.Timestamp"),
        (4, "frame_id", "string"),
        (2, "data", "bytes"),
        (3, "format", "string"),
    ),
    "foxglove.Log": (
        (1, "timestamp", "google.protobuf.Timestamp"),
        (2, "level", "foxglove.Log.Level"),
        (3, "message", "string"),
        (4, "name", "string"),
        (5, "file", "string"),
        (6, "line", "fixed32"),
    ),
    "foxglove.PointCloud": (
        (1, "timestamp", "google.protobuf.Timestamp"),
        (2, "frame_id", "string"),
        (3, "pose", "foxglove.Pose"),
        (4, "point_stride", "fixed32"),
        (5, "fields", "[foxglove.PackedElementField]"),
        (6, "data", "bytes"),
    ),
}
# Number of each type in a descriptor.
_TYPES = {"double": 1, "int64": 3, "int32": 5, "fixed32": 7, "string": 9, "bytes": 12}
_MESSAGE_TYPE, _ENUM_TYPE = 11, 14
_OPTIONAL, _REPEATED = 1, 3
LOG_LEVELS = _ENUMS["foxglove.Log.Level"]
_NS = 1_000_000_000
_FLOAT32 = 7
_UNTURNED = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}


def image(time_ns: int, frame_id: str, data: bytes, kind: str = "png") -> bytes:
    """``foxglove.CompressedImage``."""
    return _encode(
        "foxglove.CompressedImage",
        {"timestamp": _time(time_ns), "frame_id": frame_id, "data": data, "format": kind},
    )


def log_line(time_ns: int, level: str, name: str, message: str) -> bytes:
    """``foxglove.Log``; the level is one of ``LOG_LEVELS``."""
    values = {"timestamp": _time(time_ns), "level": LOG_LEVELS.index(level)}
    return _encode("foxglove.Log", values | {"message": message, "name": name})


def transforms(
    time_ns: int, frames: Iterable[tuple[str, str, Sequence[float], Sequence[float]]]
) -> bytes:
    """``foxglove.FrameTransforms`` of (parent, child, x y z in m, quaternion x y z w)."""
    items = [
        {
            "timestamp": _time(time_ns),
            "parent_frame_id": parent,
            "child_frame_id": child,
            "translation": dict(zip("xyz", place, strict=True)),
            "rotation": dict(zip("xyzw", turn, strict=True)),
        }
        for parent, child, place, turn in frames
    ]
    return _encode("foxglove.FrameTransforms", {"transforms": items})


def point_cloud(
    time_ns: int, frame_id: str, names: Sequence[str], points: npt.NDArray[np.float32]
) -> bytes:
    """``foxglove.PointCloud``; points of shape (n, len(names)), x y z first, m."""
    fields = [
        {"name": name, "offset": 4 * number, "type": _FLOAT32} for number, name in enumerate(names)
    ]
    pose = {"position": dict.fromkeys("xyz", 0.0), "orientation": _UNTURNED}
    values = {"timestamp": _time(time_ns), "frame_id": frame_id, "pose": pose, "fields": fields}
    data = np.ascontiguousarray(points, "<f4").tobytes()
    return _encode("foxglove.PointCloud", values | {"point_stride": 4 * len(names), "data": data})


@cache
def schema(name: str) -> tuple[str, str, bytes]:
    """Name, encoding and data of a schema as MCAP wants it: a serialised FileDescriptorSet."""
    needed = _needed(name)
    files = b"".join(_bytes_field(1, _file(package, needed)) for package in _packages(needed))
    return name, "protobuf", files


def _needed(name: str) -> list[str]:
    """A message and all that its fields are made of, dependencies first."""
    found: list[str] = []
    for _, _, kind in _MESSAGES[name]:
        inner = kind.strip("[]")
        if inner in _MESSAGES:
            found += [one for one in _needed(inner) if one not in found]
    return [*found, name]


def _packages(names: list[str]) -> list[str]:
    both = ["google.protobuf", "foxglove"]
    return [one for one in both if any(_package(name) == one for name in names)]


def _package(name: str) -> str:
    return "google.protobuf" if name.startswith("google.") else "foxglove"


def _file_name(package: str) -> str:
    return "google/protobuf/timestamp.proto" if package == "google.protobuf" else "foxglove.proto"


def _file(package: str, names: list[str]) -> bytes:
    """A FileDescriptorProto with the messages of one package."""
    data = _bytes_field(1, _file_name(package)) + _bytes_field(2, package)
    if package == "foxglove" and "google.protobuf.Timestamp" in names:
        data += _bytes_field(3, _file_name("google.protobuf"))
    data += b"".join(_bytes_field(4, _descriptor(n)) for n in names if _package(n) == package)
    return data + _bytes_field(12, "proto3")


def _descriptor(name: str) -> bytes:
    """A DescriptorProto."""
    data = _bytes_field(1, name.rpartition(".")[2])
    for number, field_name, kind in _MESSAGES[name]:
        inner = kind.strip("[]")
        label = _REPEATED if kind != inner else _OPTIONAL
        code = _ENUM_TYPE if inner in _ENUMS else _TYPES.get(inner, _MESSAGE_TYPE)
        field = _bytes_field(1, field_name) + _number_field(3, number) + _number_field(4, label)
        field += _number_field(5, code)
        if inner not in _TYPES:
            field += _bytes_field(6, f".{inner}")
        data += _bytes_field(2, field)
    for enum, values in _ENUMS.items():
        if enum.rpartition(".")[0] == name:
            pairs = [_bytes_field(1, v) + _number_field(2, n) for n, v in enumerate(values)]
            body = b"".join(_bytes_field(2, pair) for pair in pairs)
            data += _bytes_field(4, _bytes_field(1, enum.rpartition(".")[2]) + body)
    return data


def _encode(name: str, values: dict[str, Any]) -> bytes:
    """The message on the wire; a field that is not given is left out."""
    data = b""
    for number, field, kind in _MESSAGES[name]:
        if field in values:
            value, inner = values[field], kind.strip("[]")
            for item in value if kind != inner else [value]:
                data += _field(number, inner, item)
    return data


def _field(number: int, kind: str, value: Any) -> bytes:
    if kind in _MESSAGES:
        return _bytes_field(number, _encode(kind, value))
    if kind == "double":
        return _varint(number << 3 | 1) + struct.pack("<d", value)
    if kind == "fixed32":
        return _varint(number << 3 | 5) + struct.pack("<I", value)
    if kind in ("string", "bytes"):
        return _bytes_field(number, value)
    return _number_field(number, value)


def _bytes_field(number: int, value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _number_field(number: int, value: int) -> bytes:
    return _varint(number << 3) + _varint(value)


def _varint(value: int) -> bytes:
    value &= (1 << 64) - 1  # a negative number is its two's complement
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _time(time_ns: int) -> dict[str, int]:
    seconds, nanos = divmod(time_ns, _NS)
    return {"seconds": seconds, "nanos": nanos}
