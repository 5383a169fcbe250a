import logging
import math
import os
import socket
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

from ertis_daemon.config import PoseConfig
from ertis_daemon.config_read import parse_config
from ertis_daemon.microphones import AGREEING, MicrophoneWatch
from ertis_daemon.serving.about import quaternion, transform
from ertis_daemon.serving.backoff import Backoff
from ertis_daemon.serving.journal import JournalFormatter, is_journal
from ertis_daemon.serving.notify import Notifier
from ertis_daemon.serving.outputs import FanOut, NoWayOut
from ertis_daemon.serving.reload import ReloadError, check_models, compare
from ertis_daemon.serving.reporter import Reporter
from ertis_daemon.status import Status
from ertis_driver.audio import PdmDecoder


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """The socket that systemd listens on; a function that returns what it was told."""
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(os.fspath(path))
        listening.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", os.fspath(path))

        def told():
            lines = []
            while True:
                try:
                    lines.append(listening.recv(4096).decode())
                except BlockingIOError:
                    return lines

        yield told


def test_systemd_is_told_when_it_is_ready_how_it_goes_and_that_it_ends(systemd):
    notifier = Notifier()
    notifier.ready()
    notifier.status("a: running")
    notifier.status("a: running")
    notifier.status("b:\nwaiting")
    notifier.stopping()
    assert systemd() == ["READY=1", "STATUS=a: running", "STATUS=b: waiting", "STOPPING=1"]


def test_the_watchdog_is_fed_three_times_in_its_period_by_beats_only(systemd, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    notifier = Notifier()
    for _ in range(100):
        notifier.beat()
    assert systemd() == ["WATCHDOG=1"]
    monkeypatch.setenv("WATCHDOG_USEC", "3")
    notifier = Notifier()
    notifier.beat()
    notifier.beat()
    assert systemd() == ["WATCHDOG=1", "WATCHDOG=1"]


def test_the_watchdog_is_fed_again_well_before_its_period_is_over(systemd, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "900000")
    notifier = Notifier()
    notifier.beat()
    time.sleep(0.31)
    notifier.beat()
    assert systemd() == ["WATCHDOG=1", "WATCHDOG=1"]


def test_a_systemd_without_a_file_for_its_socket_is_told_as_well(monkeypatch):
    name = f"ertis-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.settimeout(5.0)
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
        Notifier().ready()
        assert listening.recv(100) == b"READY=1"


def test_the_watchdog_of_another_process_is_not_ours_to_feed(systemd, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", "1000")
    monkeypatch.setenv("WATCHDOG_PID", "1")
    Notifier().beat()
    assert systemd() == []


def test_without_systemd_or_with_a_dead_one_nothing_happens(systemd, monkeypatch, tmp_path):
    monkeypatch.setenv("NOTIFY_SOCKET", os.fspath(tmp_path / "gone"))
    Notifier().ready()
    monkeypatch.delenv("NOTIFY_SOCKET")
    Notifier().ready()
    assert systemd() == []


def test_each_line_for_the_journal_begins_with_its_priority():
    formatter = JournalFormatter("%(name)s: %(message)s")

    def line(level, text):
        return formatter.format(logging.LogRecord("x", level, "f", 1, text, (), None))

    assert line(logging.CRITICAL, "a") == "<2>x: a"
    assert line(logging.ERROR, "a\nb") == "<3>x: a\n<3>b"
    assert line(logging.WARNING, "a") == "<4>x: a"
    assert line(logging.INFO, "a") == "<6>x: a"
    assert line(logging.DEBUG, "a") == "<7>x: a"


def test_the_journal_is_known_by_device_and_inode(tmp_path, monkeypatch):
    with (tmp_path / "out").open("w") as stream:
        state = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{state.st_dev}:{state.st_ino}")
        assert is_journal(stream)
        assert not is_journal(sys.__stderr__)
    assert not is_journal(stream), "a closed one is none"


class Noting:
    def __init__(self, fails=False, name="out"):
        self.fails, self.name, self.got = fails, name, []

    def publish_status(self, status):
        self.got.append(status)
        if self.fails:
            raise OSError("no way out")

    publish = publish_raw = publish_status

    def describe(self, info, effective_config):
        self.publish_status(info)

    def close(self):
        self.got.append("closed")


def test_what_fails_on_one_way_out_still_goes_out_on_the_others():
    first, second, third = Noting(), Noting(fails=True), Noting()
    outputs = FanOut([first, second, third], Status())
    outputs.publish("event")
    outputs.close()
    assert first.got == second.got == third.got == ["event", "closed"]


def test_a_way_out_that_fails_is_logged_once_counted_and_named_until_it_works(caplog):
    caplog.set_level("INFO")
    status, failing = Status(device="front"), Noting(fails=True, name="ROS 2")
    outputs = FanOut([Noting(), failing], status)
    for _ in range(30):
        outputs.publish("event")
        outputs.publish_raw("frame")
    assert status.publish_failures == 60
    why = "OSError: no way out"
    assert status.to_json()["outputs_failing"] == {"ROS 2 events": why, "ROS 2 frames": why}
    assert caplog.messages == [
        "front: ROS 2 events cannot be published: counted",
        "front: ROS 2 frames cannot be published: counted",
    ]
    assert "OSError: no way out" in caplog.text
    caplog.clear()
    failing.fails = False
    outputs.publish("event")
    assert status.to_json()["outputs_failing"] == {"ROS 2 frames": why}
    failing.fails = True
    outputs.publish("event")
    assert status.publish_failures == 61
    assert caplog.messages == ["front: ROS 2 events are published again"], "it has been said"


def test_an_event_that_no_way_out_took_is_none():
    outputs = FanOut([Noting(fails=True), Noting(fails=True)], Status())
    with pytest.raises(NoWayOut):
        outputs.publish(SimpleNamespace(ping_index=3))
    outputs.publish_status({})
    outputs.describe({}, {})


def test_the_first_way_out_is_the_first_to_be_used():
    order = []

    class Telling(Noting):
        def publish(self, event):
            order.append(self)

    first, second = Telling(), Telling()
    FanOut([first, second], Status()).publish("event")
    assert order == [first, second]


def test_a_sonar_in_trouble_is_left_alone_for_twice_as_long_each_time_but_not_after_it_worked():
    backoff = Backoff()
    assert [backoff.after(worked_s=1.0) for _ in range(6)] == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]
    assert [backoff.after(worked_s) for worked_s in (3600.0, 1.0)] == [0.5, 1.0]
    backoff.reset()
    assert backoff.after(0.0) == 0.5


def test_status_goes_out_at_once_when_something_is_new_and_else_once_a_second():
    status, publisher = Status(), Noting()
    reporter = Reporter(status, publisher, lambda: {"routers": 1})
    for _ in range(5):
        status.pings_heard += 1
        reporter.tick()
    assert [one["pings_heard"] for one in publisher.got] == [1]
    status.state = "away"
    reporter.tick()
    reporter.tick()
    assert [(one["state"], one["routers"]) for one in publisher.got] == [
        ("starting", 1),
        ("away", 1),
    ]


def rotated(q, v):
    x, y, z, w = q
    axis = np.array([x, y, z])
    return v + 2 * np.cross(axis, np.cross(axis, v) + w * np.array(v))


@pytest.mark.parametrize(
    ("angles", "ahead"),
    [((0, 0, 0), (1, 0, 0)), ((0, 0, 90), (0, 1, 0)), ((0, 90, 0), (0, 0, -1))],
)
def test_yaw_looks_left_and_pitch_looks_down(angles, ahead):
    assert np.allclose(rotated(quaternion(*angles), [1, 0, 0]), ahead)


def test_turns_are_about_fixed_axes_roll_first():
    turned = rotated(quaternion(90, 0, 90), [0, 1, 0])  # left goes up by roll, and stays so by yaw
    assert np.allclose(turned, [0, 0, 1])


def test_all_three_turns_together_are_their_matrices_product():
    roll, pitch, yaw = np.radians([20.0, -35.0, 110.0])
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    about_y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    about_z = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    whole = np.array(about_z) @ about_y @ about_x
    for axis in np.eye(3):
        assert np.allclose(rotated(quaternion(20.0, -35.0, 110.0), axis), whole @ axis)


def test_a_pose_without_a_parent_is_no_transform():
    assert transform(PoseConfig(x_m=1), "sonar") is None
    told = transform(PoseConfig(parent_frame="base_link", x_m=1, z_m=0.5), "sonar")
    assert told == {
        "parent_frame_id": "base_link",
        "child_frame_id": "sonar",
        "translation_m": [1, 0.0, 0.5],
        "rotation_xyzw": [0.0, 0.0, 0.0, 1.0],
    }


def test_a_reload_says_what_it_takes_and_what_it_cannot():
    old = parse_config(
        b"sonars: {a: {}, b: {device: {address: 'sim:b'}}, c: {device: {address: 'sim:c'}}}"
    )
    new = parse_config(
        b"zenoh: {raw: true}\nsonars: {a: {temperature_c: 5, pose: {x_m: 1}},"
        b" c: {device: {address: 'sim:c'}}, d: {device: {address: 'sim:d'}}}"
    )
    changes = compare(old, new)
    assert changes.said == (
        "d: added",
        "b: removed",
        "a: opened again, for pose.x_m, temperature_c",
        "zenoh: changed, which needs a restart of the daemon",
    )
    assert [one.device.name for one in changes.changed] == ["a"]
    assert compare(old, old).said == ("nothing has changed",)


def test_a_model_that_cannot_be_loaded_is_refused_before_anything_is_stopped(tmp_path):
    (tmp_path / "m.safetensors").write_bytes(b"no model")
    for address in ("sim:x", "serial:/dev/x"):
        text = f"device: {{address: '{address}'}}\ndetector: {{model: '{tmp_path}/m.safetensors'}}"
        with pytest.raises(
            ReloadError, match=r"detector\.model of sonar 'ertis': .*m\.safetensors"
        ):
            check_models(parse_config(text.encode()).each_sonar())


def noise(seed):
    return np.random.default_rng(seed).integers(0, 2**32, 32_768, dtype=np.uint32)


def test_a_microphone_is_faulty_after_three_checks_and_well_after_three():
    watch = MicrophoneWatch(period_s=0.0)
    decoder = PdmDecoder()

    def check(words):
        whole = words[: len(words) // 10 * 10]
        return watch.check(whole, decoder.decode(whole))

    for seed in range(AGREEING - 1):
        assert check(noise(seed) & ~np.uint32(1 << 7)) == ()
    assert check(noise(9) & ~np.uint32(1 << 7)) == ("7",)
    assert watch.faulty == {"7": "stuck"}
    assert check(noise(10) & ~np.uint32(1 << 7)) == (), "told once"
    check(noise(11))
    check(noise(12))
    assert watch.faulty == {"7": "stuck"}
    check(noise(13))
    assert watch.faulty == {}
    assert check(noise(14) & ~np.uint32(1 << 7)) == (), "one ping is no fault"
    assert watch.faulty == {}
    assert math.isfinite(watch.noise_dbfs)
