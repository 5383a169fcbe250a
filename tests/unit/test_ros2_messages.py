"""Events and status as ROS messages; decoded again by rosbags where bytes matter."""

import math

import numpy as np
import pytest
from ros2_rig import MOUNTED, landmark_event, report
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ertis_daemon.config_read import parse_config
from ertis_daemon.ros2 import convert, geometry, messages
from ertis_daemon.ros2.publisher import pings_by_itself, static_transform


def reader():
    """Another store, made from the definitions that go with the messages."""
    store = get_typestore(Stores.EMPTY)
    for name in (messages.DETECTIONS, messages.DIAGNOSTICS):
        store.register(get_types_from_msg(messages.definition(name), name))
    return store


def rotated(xyzw, vector):
    x, y, z, w = xyzw
    axis = np.array([x, y, z])
    return vector + 2.0 * np.cross(axis, np.cross(axis, vector) + w * vector)


def test_type_hashes_are_those_that_ros_publishes():
    hashes = {name: messages.kind(name).type_hash for name in (messages.DETECTIONS, messages.POSE)}
    assert hashes == {
        "vision_msgs/msg/Detection3DArray": (
            "RIHS01_793f5eab9595ac1c0da07873cc859db42eae51f0ee76056db8562515d830e018"
        ),
        "geometry_msgs/msg/PoseStamped": (
            "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"
        ),
    }
    assert messages.kind(messages.DIAGNOSTICS).type_hash == (
        "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    )


def test_a_message_without_a_field_is_no_message():
    with pytest.raises(TypeError, match="frame_id"):
        messages.new("std_msgs/msg/Header", stamp=messages.header(0, "").stamp)


def test_the_line_of_sight_points_at_the_landmark():
    for azimuth, elevation in [(0.0, 0.0), (0.7, 0.0), (-1.2, 0.4), (2.5, -0.9)]:
        place = geometry.position(3.0, azimuth, elevation)
        assert np.linalg.norm(place) == pytest.approx(3.0)
        ahead = rotated(geometry.line_of_sight(azimuth, elevation), np.array([3.0, 0.0, 0.0]))
        assert ahead == pytest.approx(place)
    left_and_up = geometry.position(1.0, math.pi / 4, math.pi / 6)
    assert left_and_up[1] > 0
    assert left_and_up[2] == pytest.approx(0.5)


def test_the_cartesian_covariance_is_that_of_many_drawn_landmarks():
    spherical = np.array([[4e-4, 1e-5, 0.0], [1e-5, 1e-4, 2e-5], [0.0, 2e-5, 9e-4]])
    mean = np.array([2.0, 0.6, -0.3])
    drawn = np.random.default_rng(5).multivariate_normal(mean, spherical, 40_000)
    places = np.array([geometry.position(*row) for row in drawn])
    expected = np.cov(places.T)
    found = geometry.cartesian_covariance(*mean, spherical)
    assert found == pytest.approx(expected, rel=0.05, abs=3e-5)
    assert (found == found.T).all()


def test_an_unknown_elevation_makes_a_wide_covariance_and_no_nan():
    nan = math.nan
    covariance = ((1e-4, 0, nan), (0, 1e-4, nan), (nan, nan, nan))
    found = geometry.cartesian_covariance(2.0, 0.0, nan, covariance)
    assert np.isfinite(found).all()
    assert found[2, 2] == pytest.approx(4.0 * geometry.UNKNOWN_ANGLE_VARIANCE)
    assert found[0, 0] == pytest.approx(1e-4)
    assert geometry.position(2.0, 0.5, nan)[2] == 0.0


def test_detections_read_back_as_published():
    event = landmark_event(report(1), report(2, label="r58", radius_m=None), time_ns=5_000_000_007)
    data = messages.encode(convert.detections(event))
    read = reader().deserialize_cdr(data, messages.DETECTIONS)
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (5, 7)
    first, second = read.detections
    assert (first.id, second.id) == ("1", "2")
    assert first.header.frame_id == "sonar"
    assert [(r.hypothesis.class_id, r.hypothesis.score) for r in first.results] == [
        ("r48", 0.95),
        ("r58", 0.03),
    ]
    assert (first.bbox.size.x, first.bbox.size.y, first.bbox.size.z) == (0.096,) * 3
    assert second.bbox.size.x == 0.0
    assert [r.hypothesis.class_id for r in second.results] == ["r58", "r48"], "its own class first"
    covariance = first.results[0].pose.covariance.reshape(6, 6)
    assert covariance[:3, :3] == pytest.approx(
        geometry.cartesian_covariance(2.0, 0.2, 0.1, report().covariance)
    )
    assert np.diag(covariance)[3:].tolist() == [9999.0] * 3


def test_lost_landmarks_and_those_without_a_range_are_no_detections():
    event = landmark_event(report(1, "lost"), report(2, range_m=math.nan))
    assert convert.detections(event).detections == []


def test_diagnostics_judge_what_happened_since_the_last_status():
    diagnosis = convert.Diagnosis("t")

    def judge(**status):
        (entry,) = diagnosis.message(status, 0).status
        return entry.level, entry.message

    assert judge(pings_heard=5, queue_drops=0) == (convert.OK, "listening")
    assert judge(pings_heard=9, queue_drops=2) == (convert.WARN, "queue_drops +2")
    assert judge(pings_heard=12, queue_drops=2) == (convert.OK, "listening")
    assert judge(pings_heard=12, queue_drops=2) == (convert.WARN, "no ping heard")
    assert judge(pings_heard=13, microphones_faulty={"7": "stuck"}) == (
        convert.WARN,
        "microphone 7 stuck",
    )
    failing = {"ROS 2 frames": "why"}
    assert judge(pings_heard=14, publish_failures=2, outputs_failing=failing) == (
        convert.WARN,
        "publish_failures +2, ROS 2 frames: why",
    )
    assert judge(pings_heard=14, state="away", reason="unplugged") == (
        convert.ERROR,
        "away, unplugged",
    )
    assert judge(pings_heard=13, state="ended") == (convert.STALE, "ended")


def test_no_ping_is_worth_a_warning_only_where_and_when_one_was_to_come():
    diagnosis = convert.Diagnosis("t")

    def level(**status):
        return diagnosis.message(status, 0).status[0].level

    assert level(pings_heard=5, ping_rate_hz=7.0) == convert.OK
    assert level(pings_heard=5, ping_rate_hz=7.0) == convert.OK, "on change, between two pings"
    assert level(pings_heard=5, ping_rate_hz=0.0) == convert.WARN
    diagnosis.expects_pings = False
    assert level(pings_heard=5, ping_rate_hz=0.0) == convert.OK


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (b"{}", True),
        (b"ping_rate_hz: 2", True),
        (b"ping_rate_hz: 0.1", False),
        (b"ping_on: pin1", False),
        (b"{ping_on: command, zenoh: {commands: true}}", False),
    ],
)
def test_a_sonar_that_pings_when_asked_to_is_not_expected_to_ping(config, expected):
    (sonar,) = parse_config(config).each_sonar()
    assert pings_by_itself(sonar.to_json()) is expected


def test_diagnostics_tell_every_field_of_the_status():
    diagnosis = convert.Diagnosis("t")
    diagnosis.hardware_id = "serial:sn=1"
    status = {"pings_heard": 1, "model": "m", "noise_dbfs": None, "microphones_faulty": {"3": "x"}}
    message = diagnosis.message(status, 1)
    data = messages.encode(message)
    (entry,) = reader().deserialize_cdr(data, messages.DIAGNOSTICS).status
    assert (entry.name, entry.hardware_id) == ("ertis: t", "serial:sn=1")
    assert {pair.key: pair.value for pair in entry.values} == {
        "pings_heard": "1",
        "model": "m",
        "noise_dbfs": "null",
        "microphones_faulty.3": "x",
    }


def test_the_static_transform_is_that_of_the_info():
    (transform,) = static_transform(MOUNTED["transform"], 1).transforms
    turn = transform.transform.rotation
    ahead = rotated((turn.x, turn.y, turn.z, turn.w), np.array([1.0, 0.0, 0.0]))
    assert ahead == pytest.approx([0.0, 1.0, 0.0]), "turned left"
    assert (transform.header.frame_id, transform.child_frame_id) == ("base_link", "sonar")
    assert transform.transform.translation.z == 0.5
