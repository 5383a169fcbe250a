"""Our bytes and schemas against Foxglove's own package."""

import struct

import numpy as np
import pytest
from foxglove_schemas_protobuf import (
    CompressedImage_pb2,
    FrameTransforms_pb2,
    Log_pb2,
    PointCloud_pb2,
)
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.unknown_fields import UnknownFieldSet

from ertis_driver import foxglove

TIME_NS = 1_700_000_000_123_456_789
KINDS = {
    "foxglove.CompressedImage": CompressedImage_pb2.CompressedImage,
    "foxglove.Log": Log_pb2.Log,
    "foxglove.FrameTransforms": FrameTransforms_pb2.FrameTransforms,
    "foxglove.PointCloud": PointCloud_pb2.PointCloud,
}


def of_the_schema(name):
    """The message class that a viewer makes of our schema."""
    found_name, encoding, data = foxglove.schema(name)
    assert (found_name, encoding) == (name, "protobuf")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def described(descriptor):
    """Fields by number, all the way down."""
    return {
        field.number: (
            field.name,
            field.type,
            field.is_repeated,
            described(field.message_type) if field.message_type else None,
            {v.name: v.number for v in field.enum_type.values} if field.enum_type else None,
            (field.enum_type or field.message_type or field).full_name.rpartition(".")[0]
            if field.enum_type or field.message_type
            else None,
        )
        for field in descriptor.fields
    }


@pytest.mark.parametrize("name", KINDS)
def test_a_schema_is_foxgloves(name):
    assert described(of_the_schema(name).DESCRIPTOR) == described(KINDS[name].DESCRIPTOR)


def both(name, data):
    """What Foxglove's class and our schema's class make of the bytes: the same."""
    theirs, ours = KINDS[name].FromString(data), of_the_schema(name).FromString(data)
    assert str(theirs) == str(ours)
    assert len(UnknownFieldSet(theirs)) == len(UnknownFieldSet(ours)) == 0
    return theirs


def test_a_picture_reads_as_one():
    found = both("foxglove.CompressedImage", foxglove.image(TIME_NS, "sonar", b"\x89PNG\0\xff"))
    assert (found.data, found.format, found.frame_id) == (b"\x89PNG\0\xff", "png", "sonar")
    assert (found.timestamp.seconds, found.timestamp.nanos) == divmod(TIME_NS, 10**9)


def test_a_log_line_reads_as_one():
    found = both("foxglove.Log", foxglove.log_line(TIME_NS, "WARNING", "ertis", "3 pings löst"))
    assert (found.level, found.name, found.message) == (
        Log_pb2.Log.WARNING,
        "ertis",
        "3 pings löst",
    )


def test_frames_read_as_they_are():
    frames = [
        ("sonar", "emitter", (0.0, -0.5, 2.0), (0.0, 0.0, 0.6, 0.8)),
        ("a", "b", (1, 1, 1), (0, 0, 0, 1)),
    ]
    found = both("foxglove.FrameTransforms", foxglove.transforms(TIME_NS, frames))
    first = found.transforms[0]
    assert (first.parent_frame_id, first.child_frame_id) == ("sonar", "emitter")
    assert (first.translation.y, first.translation.z, first.rotation.w) == (-0.5, 2.0, 0.8)
    assert len(found.transforms) == 2


def test_points_read_as_they_are():
    points = np.arange(8, dtype=np.float32).reshape(2, 4)
    names = ("x", "y", "z", "radius_m")
    found = both("foxglove.PointCloud", foxglove.point_cloud(TIME_NS, "sonar", names, points))
    assert found.point_stride == 16
    assert [(f.name, f.offset, f.type) for f in found.fields] == [
        (name, 4 * n, 7) for n, name in enumerate(names)
    ]
    assert struct.unpack("<8f", found.data) == tuple(range(8))
    assert found.pose.orientation.w == 1.0
