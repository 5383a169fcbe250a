import json
import os
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from ertis_daemon.config import RecordConfig
from ertis_daemon.recording.folder import NoRoom, RecordingFolder, state_folder
from ertis_daemon.recording.recorder import LONGEST_S, MAX_SAVED, SPARE_FRAMES, Recorder
from ertis_daemon.recording.ring import FrameRing
from ertis_daemon.status import Status
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, read_recording

NUM_WORDS = 32_768
INFO = RecordingInfo(source="sim", chirp=DEFAULT_CHIRP, num_words=NUM_WORDS, temperature_c=20.0)


def frame(index):
    return PdmFrame(np.full(NUM_WORDS, index, np.uint32), index, 1_000_000 * index)


@pytest.fixture
def make(tmp_path):
    made = []

    def make(*, keeps_ring=True, **config):
        values = {"folder": str(tmp_path / "rec"), "keep_free_mb": 0, **config}
        recorder = Recorder(RecordConfig(**values), "s", Status(), keeps_ring=keeps_ring)
        recorder.begin(INFO)
        made.append(recorder)
        return recorder

    yield make
    for recorder in made:
        recorder.close()


def indices(path):
    return [ping.frame.ping_index for ping in read_recording(path)]


def wait_for(condition):
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_ring_keeps_what_is_young_enough_and_no_more_bytes_than_allowed():
    ring = FrameRing(0.2, 3 * 4 * NUM_WORDS)
    for index in range(5):
        ring.append(frame(index))
    assert [one.ping_index for one in ring.newest(1.0)] == [2, 3, 4]
    assert ring.num_bytes == 3 * 4 * NUM_WORDS
    time.sleep(0.25)
    ring.append(frame(5))
    assert [one.ping_index for one in ring.newest(1.0)] == [5]
    none = FrameRing(0.0, 10**9)
    none.append(frame(0))
    assert none.newest(1.0) == []


def test_a_trigger_records_the_pings_before_it_and_those_after(make):
    recorder = make(before_s=5.0, after_s=0.3)
    for index in range(4):
        recorder.heard(frame(index))
    path = recorder.trigger("new")
    assert path.name.startswith("s-2")
    assert path.name.endswith("Z-new.mcap")
    for index in range(4, 7):
        recorder.heard(frame(index))
    wait_for(lambda: recorder._status.recordings == 1)
    recorder.heard(frame(7))  # too late
    assert indices(path) == list(range(7))
    assert read_recording(path).info == INFO


def test_events_are_recorded_with_their_pings_and_no_older_ones(make):
    recorder = make(before_s=5.0, after_s=0.2)

    def event(index):
        landmark = {"class": "r48", "range_m": 1.0, "azimuth_rad": 0.0, "elevation_rad": 0.0}
        return json.dumps({"ping_index": index, "landmarks": [landmark]}).encode()

    recorder.published(event(0), 0)  # of a ping that is not kept any more
    for index in range(1, 4):
        recorder.heard(frame(index))
        recorder.published(event(index), 1_000_000 * index)
    path = recorder.trigger("new")
    recorder.heard(frame(4))
    recorder.published(event(4), 4_000_000)
    wait_for(lambda: recorder._status.recordings == 1)
    with path.open("rb") as file:
        reader = make_reader(file)
        events = [
            (message.log_time, json.loads(message.data)["ping_index"])
            for _, _, message in reader.iter_messages(topics=["events"])
        ]
    assert events == [(1_000_000 * index, index) for index in range(1, 5)]


def test_a_recording_of_no_time_at_all_is_none(make):
    recorder = make(before_s=5.0, after_s=60.0)
    recorder.heard(frame(0))
    path = recorder.trigger("on-demand", before_s=0.0, after_s=0.0)
    time.sleep(0.01)
    recorder.heard(frame(1))
    wait_for(lambda: recorder._status.recordings_failed == 1)
    assert not path.exists(), "a recording of nothing is none"


def test_a_second_trigger_prolongs_the_recording_under_way(make):
    recorder = make(before_s=5.0, after_s=1.0)
    recorder.heard(frame(0))
    path = recorder.trigger("new")
    assert recorder.trigger("lost", after_s=3.0) == path
    time.sleep(1.2)
    recorder.heard(frame(1))
    wait_for(lambda: recorder._status.recordings == 1)
    assert indices(path) == [0, 1]


def test_frames_that_the_disk_does_not_take_are_counted_and_not_hoarded(make, caplog):
    caplog.set_level("WARNING")
    recorder = make(before_s=5.0, after_s=60.0)
    recorder.heard(frame(0))
    with recorder._changed:  # nothing is taken meanwhile
        path = recorder.trigger("new")
        for index in range(1, 100):
            recorder.heard(frame(index))
    recorder.close()
    assert indices(path) == list(range(1 + SPARE_FRAMES))
    assert f"misses {99 - SPARE_FRAMES} pings" in caplog.text


def test_no_number_of_triggers_prolongs_a_recording_for_ever(make):
    recorder = make(before_s=5.0, after_s=60.0)
    recorder.heard(frame(0))
    recorder.trigger("new")
    for _ in range(3):
        recorder.trigger("lost", after_s=LONGEST_S)
    assert recorder._now.ends_s == recorder._now.began_s + LONGEST_S


def test_no_ring_is_kept_for_a_recorder_that_nothing_triggers(make):
    recorder = make(keeps_ring=False)
    recorder.heard(frame(0))
    assert recorder._ring.num_bytes == 0
    assert not recorder.wants_events
    recorder.trigger("on-demand", after_s=5.0)
    assert recorder.wants_events


def test_a_sonar_opened_anew_ends_the_recording_and_forgets_what_was_before(make):
    recorder = make(before_s=5.0, after_s=60.0)
    recorder.heard(frame(0))
    path = recorder.trigger("new")
    recorder.begin(INFO)
    wait_for(lambda: recorder._status.recordings == 1)
    assert indices(path) == [0]
    recorder.heard(frame(9))
    path = recorder.trigger("new", after_s=0.0)
    wait_for(lambda: recorder._status.recordings == 2)
    assert indices(path) == [9]


def test_single_pings_are_saved_but_not_without_end(make):
    recorder = make(before_s=0.0)
    for index in range(MAX_SAVED + 5):
        recorder.save(frame(index), f"failed-ping-{index}")
        time.sleep(0.01)
    wait_for(lambda: recorder._status.recordings == MAX_SAVED)
    names = sorted(path.name for path in recorder._folder.new_path("x").parent.iterdir())
    assert len(names) == MAX_SAVED
    assert names[3].endswith("-failed-ping-3.mcap")


def test_closing_finishes_what_is_under_way(make):
    recorder = make(before_s=5.0, after_s=60.0)
    recorder.heard(frame(3))
    path = recorder.trigger("new")
    recorder.close()
    assert indices(path) == [3]
    with pytest.raises(NoRoom):
        recorder.trigger("new")


def test_before_the_sonar_was_open_there_is_nothing_to_record(tmp_path):
    recorder = Recorder(RecordConfig(folder=str(tmp_path)), "s", Status(), keeps_ring=True)
    with pytest.raises(NoRoom, match="not open yet"):
        recorder.trigger("new")


def test_a_folder_that_cannot_be_made_is_one_clear_line(make, tmp_path, caplog):
    (tmp_path / "rec").write_text("a file")
    recorder = make(before_s=5.0)
    recorder.heard(frame(0))
    recorder.trigger("new")
    wait_for(lambda: recorder._status.recordings_failed == 1)
    (told,) = caplog.messages
    assert re.fullmatch(
        r"nothing recorded: cannot make .*rec: File exists; see record\.folder", told
    )


@pytest.fixture
def hung_disk(monkeypatch):
    """A network's disk that does not answer: making a folder on it waits until this is set."""
    answers, gave_up, make_folder = threading.Event(), [], Path.mkdir

    def mkdir(path, *arguments, **options):
        if not answers.wait(5.0):
            gave_up.append(path)
        make_folder(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    yield answers
    answers.set()
    assert gave_up == [], "somebody waited for the disk who must not"


def test_a_disk_that_does_not_answer_holds_up_neither_pings_nor_who_asks(make, hung_disk):
    recorder = make(before_s=5.0, after_s=0.2)
    recorder.heard(frame(0))
    path = recorder.trigger("new")
    recorder.heard(frame(1))
    assert recorder.trigger("lost") == path
    recorder.save(frame(1), "failed-ping-1")
    assert not path.parent.exists()
    hung_disk.set()
    wait_for(lambda: recorder._status.recordings == 2)
    assert indices(path) == [0, 1]


def test_recordings_that_wait_for_a_hung_disk_are_bounded_in_memory(make, hung_disk):
    recorder = make(before_s=60.0, after_s=0.0, memory_mb=8)  # 61 frames of 131 kB
    refused = 0
    for index in range(200):
        recorder.heard(frame(index % 50))
        time.sleep(1e-4)
        try:
            recorder.trigger("new")
        except NoRoom:
            refused += 1
    held = sum(len(one.frames) for one in recorder._waiting)
    assert refused > 50
    assert held + SPARE_FRAMES >= 61
    assert held <= 61 + 3 * SPARE_FRAMES
    hung_disk.set()


def write(folder, name, size):
    folder.mkdir(exist_ok=True)
    (folder / name).write_bytes(bytes(size))


def test_the_oldest_recordings_of_this_sonar_make_room_and_no_other_file(tmp_path):
    for day in range(1, 5):
        write(tmp_path, f"s-2026010{day}T000000.000Z-new.mcap", 1000)
        write(tmp_path, f"s-2-2026010{day}T000000.000Z-new.mcap", 1000)
    write(tmp_path, "s-notes.mcap", 5000)
    folder = RecordingFolder(str(tmp_path), "s", 4500, 0)
    folder.make_room(folder.new_path("new"), 2000)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert [name for name in left if name.startswith("s-2026")] == [
        "s-20260103T000000.000Z-new.mcap",
        "s-20260104T000000.000Z-new.mcap",
    ]
    assert len(left) == 2 + 4 + 1


def test_the_oldest_recordings_make_room_on_a_disk_that_is_nearly_full(tmp_path):
    for day in (1, 2):
        with (tmp_path / f"s-2026010{day}T000000.000Z-new.mcap").open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, 64_000_000)
    disk = os.statvfs(tmp_path)
    keep_free = disk.f_bavail * disk.f_frsize - 32_000_000
    folder = RecordingFolder(str(tmp_path), "s", 10**9, keep_free)
    folder.make_room(folder.new_path("new"), 64_000_000)
    assert [path.name for path in tmp_path.iterdir()] == ["s-20260102T000000.000Z-new.mcap"]


@pytest.mark.parametrize(
    ("max_bytes", "keep_free", "told"),
    [
        (1_000_000, 0, "this recording may need 2 MB, record.folder_mb allows 1"),
        (10**9, 10**18, "record.keep_free_mb"),
    ],
)
def test_where_no_removal_makes_room_nothing_is_removed(tmp_path, max_bytes, keep_free, told):
    names = [f"s-2026010{day}T000000.000Z-new.mcap" for day in (1, 2)]
    for name in names:
        write(tmp_path, name, 1000)
    folder = RecordingFolder(str(tmp_path), "s", max_bytes, keep_free)
    with pytest.raises(NoRoom, match=re.escape(told)):
        folder.make_room(folder.new_path("new"), 2_000_000)
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_recording_for_whose_first_pings_there_is_no_room_costs_no_older_one(make, tmp_path):
    old = "s-20260101T000000.000Z-new.mcap"
    write(tmp_path / "rec", old, 1000)
    recorder = make(before_s=5.0, after_s=0.0, folder_mb=2)  # 15 frames of 131 kB
    recorder.heard(frame(0))
    recorder.trigger("new")
    wait_for(lambda: recorder._status.recordings_failed == 1)
    assert [path.name for path in (tmp_path / "rec").iterdir()] == [old]


def test_recordings_of_a_clock_that_was_ahead_make_room_as_well(tmp_path):
    for day in range(1, 5):
        write(tmp_path, f"s-2096010{day}T000000.000Z-new.mcap", 1000)
    folder = RecordingFolder(str(tmp_path), "s", 4500, 0)
    path = folder.new_path("new")
    write(tmp_path, path.name, 1000)
    folder.make_room(path, 2000)
    assert sorted(one.name for one in tmp_path.iterdir()) == [
        path.name,
        "s-20960104T000000.000Z-new.mcap",
    ]


def test_a_recording_larger_than_the_folder_may_be_ends_with_what_there_is_room_for(make):
    recorder = make(before_s=0.0, after_s=60.0, folder_mb=5)  # 38 frames of 131 kB
    path = recorder.trigger("new")
    for index in range(60):
        recorder.heard(frame(index))
        time.sleep(0.005)
    wait_for(lambda: recorder._status.recordings_failed == 1)
    assert 16 <= len(indices(path)) <= 38
    assert path.stat().st_size < 5_000_000


def test_a_disk_that_would_be_too_full_is_left_alone(make):
    recorder = make(before_s=5.0, after_s=0.0, keep_free_mb=10**9)
    recorder.heard(frame(0))
    path = recorder.trigger("new")
    wait_for(lambda: recorder._status.recordings_failed == 1)
    assert not path.exists()


def test_a_ping_that_no_file_can_hold_does_not_end_the_recorder(make, caplog):
    recorder = make(before_s=5.0, after_s=0.0)
    recorder.heard(PdmFrame(np.zeros(NUM_WORDS, np.uint32), 0, -1))  # MCAP has no time before 1970
    recorder.trigger("new")
    wait_for(lambda: recorder._status.recordings_failed == 1)
    assert "nothing recorded" in caplog.text
    recorder.begin(INFO)
    recorder.heard(frame(1))
    path = recorder.trigger("new")
    wait_for(lambda: recorder._status.recordings == 1)
    assert indices(path) == [1]


def test_the_state_folder_is_systemds_or_the_users(monkeypatch):
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NoRoom, match=r"record\.folder"):
        state_folder()
    monkeypatch.setenv("HOME", "/home/me")
    assert os.fspath(state_folder()) == "/home/me/.local/state/ertis"
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert os.fspath(state_folder()) == "/state/ertis"
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/ertis:/var/lib/other")
    assert os.fspath(state_folder()) == "/var/lib/ertis"
