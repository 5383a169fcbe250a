"""What the writer leaves on the disk, read by others too, and what it does without room."""

import json
import os
import resource
import threading
from contextlib import contextmanager

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from test_recording import INFO, TRUTH, make_frame

from ertis_driver.errors import DiskFull, RecordingDamaged, RecordingError
from ertis_driver.mcap_reader import read_entries
from ertis_driver.mcap_summary import read_summary
from ertis_driver.recording import RecordingWriter, open_recording
from ertis_driver.recover import recover

LANDMARK = {"range_m": 2.0, "azimuth_rad": np.pi / 2, "elevation_rad": 0.0, "radius_m": 0.048}
EVENT = json.dumps({"landmarks": [LANDMARK | {"track_id": 7}]}).encode()


def write_all(path, **options):
    """A recording with a message of each kind."""
    with RecordingWriter(path, INFO, event_schema=b'{"title": "landmarks"}', **options) as writer:
        for index in range(3):
            frame = make_frame(index)
            writer.write(frame, TRUTH if index else None)
            writer.write_event(EVENT, frame.ping_time_ns)
            writer.write_picture(b"\x89PNG", frame.ping_time_ns)
            writer.write_log("WARNING", "2 pings lost", frame.ping_time_ns)
    return path


@pytest.mark.parametrize("compress", [False, True])
def test_the_reference_reader_finds_everything_by_the_index(tmp_path, compress):
    path = write_all(tmp_path / "a.mcap", compress=compress)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        counts = summary.statistics.channel_message_counts
        topics = {channel.topic: counts.get(channel.id, 0) for channel in summary.channels.values()}
        assert topics == {
            **dict.fromkeys(("pdm", "ping", "events", "detections", "picture", "log"), 3),
            "truth": 2,
            "truth/points": 2,
            "microphones": 1,
            "tf": 1,
        }
        times = [message.log_time for _, _, message in reader.iter_messages(["pdm"])]
        assert times == [make_frame(index).ping_time_ns for index in range(3)]
        logs = [decoded for *_, decoded in reader.iter_decoded_messages(["log"])]
        assert [line.message for line in logs] == ["2 pings lost"] * 3
        assert {item.name for item in reader.iter_metadata()} == {"ertis", "ertis.copy"}


def test_an_event_is_kept_byte_for_byte_and_its_landmarks_are_points(tmp_path):
    entries = list(read_entries(write_all(tmp_path / "a.mcap")))
    events = [bytes(e.message.data) for e in entries if e.channel.topic == "events"]
    assert events == [EVENT] * 3
    cloud = PointCloud.FromString(
        next(bytes(e.message.data) for e in entries if e.channel.topic == "detections")
    )
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "radius_m", "track_id"]
    np.testing.assert_allclose(
        np.frombuffer(cloud.data, "<f4"), [0, 2, 0, 0.048, 7], atol=1e-6, err_msg="left is +y"
    )


@pytest.mark.parametrize("event", [b"{", b"[]", b'"landmarks"', b"{}", b"\xff", b"[" * 100_000])
def test_what_is_no_event_is_refused_and_not_written(tmp_path, event):
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        with pytest.raises(RecordingError, match="not an event"):
            writer.write_event(event, 0)
        writer.write(make_frame(0))
    assert "events" not in read_summary(tmp_path / "a.mcap").num_messages


def test_landmarks_without_a_place_are_no_points_but_kept(tmp_path):
    event = b'{"landmarks": [{"range_m": null}, 5]}'
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        writer.write_event(event, 0)
    counts = read_summary(tmp_path / "a.mcap").num_messages
    assert counts == {"events": 1, "detections": 1}


def test_a_compressed_recording_reads_back_the_same_and_is_smaller_where_it_is_quiet(tmp_path):
    sizes = {}
    for compress in (False, True):
        path = tmp_path / f"{compress}.mcap"
        with RecordingWriter(path, INFO, compress=compress) as writer:
            frame = make_frame(0)
            frame.words[1000:] = frame.words[1000]
            writer.write(frame)
        (ping,) = open_recording(path)
        np.testing.assert_array_equal(ping.frame.words, frame.words)
        sizes[compress] = path.stat().st_size
    assert sizes[True] < sizes[False] / 3


def test_threads_may_share_a_writer(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, INFO) as writer:

        def events():
            for time_ns in range(200):
                writer.write_event(EVENT, time_ns)

        threads = [threading.Thread(target=events) for _ in range(3)]
        for thread in threads:
            thread.start()
        for index in range(20):
            writer.write(make_frame(index))
        for thread in threads:
            thread.join()
    assert [p.frame.ping_index for p in open_recording(path)] == list(range(20))
    assert read_summary(path).num_messages["events"] == 600


@pytest.mark.parametrize("period_s", [0.0, 1e-6])
def test_synchronising_changes_nothing_in_the_file(tmp_path, period_s):
    write_all(tmp_path / "a.mcap", sync_period_s=period_s)
    write_all(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@contextmanager
def files_of_at_most(size):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def fill(path):
    """How many pings fit, and what was said then."""
    count = 0
    with RecordingWriter(path, INFO) as writer:
        try:
            while count < 100:
                writer.write(make_frame(count))
                count += 1
        except DiskFull as error:
            return count, str(error)
    raise AssertionError("the disk is not full")


def test_a_full_disk_stops_cleanly_and_the_recording_has_an_end(tmp_path):
    path = tmp_path / "a.mcap"
    with files_of_at_most(1 << 20):
        count, said = fill(path)
    assert count == 7
    assert said.endswith("File too large: free some space")
    assert "\n" not in said
    assert len(list(open_recording(path))) == count


def test_a_disk_too_full_for_the_end_leaves_whole_pings(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(tmp_path / "b.mcap", INFO) as writer:
        for index in range(2):
            writer.write(make_frame(index))
        limit = writer.size
    with files_of_at_most(limit + 10), pytest.raises(DiskFull):
        fill(path)
    pings = iter(open_recording(path))
    assert [next(pings).frame.ping_index for _ in range(2)] == [0, 1]
    with pytest.raises(RecordingDamaged, match="cut off"):
        next(pings)
    assert recover(path, tmp_path / "c.mcap").num_pings == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount")
def test_a_full_file_system_stops_cleanly_and_what_was_written_is_readable(tmp_path):
    import subprocess

    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(tmp_path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting is not allowed here")
    try:
        count, said = fill(tmp_path / "a.mcap")
        assert count == 7
        assert "No space left" in said
        assert len(list(open_recording(tmp_path / "a.mcap"))) == count
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_a_disk_without_room_for_a_beginning_says_so(tmp_path):
    with files_of_at_most(1000), pytest.raises(DiskFull, match="free some space"):
        RecordingWriter(tmp_path / "a.mcap", INFO)
