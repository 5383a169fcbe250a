import hashlib

import numpy as np
import pytest
from test_recording import INFO, NUM_WORDS, TRUTH, make_frame

from ertis_driver.errors import RecordingError
from ertis_driver.mcap_summary import read_summary
from ertis_driver.recording import RecordingInfo, RecordingWriter, open_recording
from ertis_driver.recover import recover

NUM_PINGS = 5
EVENT = b'{"landmarks": [{"range_m": 2.0, "azimuth_rad": 0.1, "elevation_rad": 0.0}]}'


def write(path, info=INFO, **options):
    with RecordingWriter(path, info, **options) as writer:
        for index in range(NUM_PINGS):
            frame = make_frame(index)
            writer.write(frame, TRUTH)
            writer.write_event(EVENT, frame.ping_time_ns)
    return path


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "compressed"])
def whole(request, tmp_path_factory):
    return write(tmp_path_factory.mktemp("whole") / "a.mcap", compress=request.param).read_bytes()


def recovered(data, folder):
    """What is saved of damaged bytes; checks that the result is a whole recording."""
    (folder / "bad.mcap").write_bytes(data)
    out = folder / "good.mcap"
    out.unlink(missing_ok=True)
    found = recover(folder / "bad.mcap", out)
    pings = list(open_recording(out))
    assert len(pings) == found.num_pings == read_summary(out).num_pings
    for ping in pings:
        expected = make_frame(ping.frame.ping_index)
        np.testing.assert_array_equal(ping.frame.words, expected.words)
        assert ping.truth == TRUTH
    assert not list(folder.glob("*.part"))
    return found


def chunk_starts(data, tmp_path):
    """Offsets of the chunks with a ping."""
    from ertis_driver.mcap_reader import read_entries

    (tmp_path / "look.mcap").write_bytes(data)
    entries = read_entries(tmp_path / "look.mcap")
    return [entry.offset for entry in entries if entry.channel.topic == "pdm"]


def test_a_whole_recording_is_copied_without_loss(whole, tmp_path):
    found = recovered(whole, tmp_path)
    assert found.was_whole
    assert (found.num_pings, found.pings_lost, found.bytes_lost) == (NUM_PINGS, 0, 0)
    assert found.other_messages == 2 * NUM_PINGS + 2, "events, their points, and the layout"
    assert open_recording(tmp_path / "good.mcap").info == INFO


def test_a_file_cut_anywhere_is_recovered_up_to_the_cut(whole, tmp_path):
    starts = chunk_starts(whole, tmp_path)
    for cut in range(starts[0] + 1, len(whole), len(whole) // 23):
        if cut < starts[1]:
            continue
        found = recovered(whole[:cut], tmp_path)
        begun = sum(start < cut for start in starts)
        assert found.num_pings in (begun, begun - 1)
        assert found.num_pings + found.pings_lost == begun
        assert not found.was_whole


def test_the_pings_after_damage_are_saved_too_and_the_lost_one_is_counted(whole, tmp_path):
    start = chunk_starts(whole, tmp_path)[2]
    for at in (start, start + 3, start + 40, start + 70_000):
        damaged = bytearray(whole)
        damaged[at] ^= 4
        found = recovered(damaged, tmp_path)
        assert (found.num_pings, found.pings_lost) == (NUM_PINGS - 1, 1)
        assert [hole.start for hole in found.holes] == [start]


def test_a_stretch_of_rubbish_costs_what_it_covers(whole, tmp_path):
    starts = chunk_starts(whole, tmp_path)
    damaged = bytearray(whole)
    damaged[starts[1] - 5 : starts[3] + 5] = np.random.default_rng(2).bytes(
        starts[3] - starts[1] + 10
    )
    found = recovered(damaged, tmp_path)
    assert found.pings_lost == 3
    assert [p.frame.ping_index for p in open_recording(tmp_path / "good.mcap")] == [0, 4]


def test_one_damaged_copy_of_the_metadata_costs_nothing(whole, tmp_path):
    damaged = whole.replace(b"21.5", b"31.5", 1)
    assert damaged != whole
    found = recovered(damaged, tmp_path)
    assert found.num_pings == NUM_PINGS
    assert not found.info_lost
    assert open_recording(tmp_path / "good.mcap").info == INFO


def test_pings_outlive_their_metadata(whole, tmp_path):
    found = recovered(whole.replace(b"21.5", b"31.5", 2), tmp_path)
    assert (found.num_pings, found.info_lost) == (NUM_PINGS, True)
    info = open_recording(tmp_path / "good.mcap").info
    assert info.source == "replay", "who made it is not known any more"
    assert info == RecordingInfo("replay", None, NUM_WORDS, note=info.note)


def test_recovering_what_was_recovered_changes_nothing(whole, tmp_path):
    recovered(whole[: len(whole) * 2 // 3], tmp_path)
    first = (tmp_path / "good.mcap").read_bytes()
    assert recovered(first, tmp_path).was_whole
    again = (tmp_path / "good.mcap").read_bytes()
    assert hashlib.sha256(first).digest() == hashlib.sha256(again).digest()


@pytest.mark.parametrize("data", [b"", b"RIFF" + bytes(1000), b"\x89MCAP0\r\n", bytes(200_000)])
def test_what_holds_no_ping_is_refused_in_one_line_and_leaves_nothing(tmp_path, data):
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(RecordingError, match="no whole ping of a sonar recording") as caught:
        recover(tmp_path / "bad.mcap", tmp_path / "good.mcap")
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == ["bad.mcap"]


def test_nothing_is_overwritten(whole, tmp_path):
    (tmp_path / "bad.mcap").write_bytes(whole)
    (tmp_path / "good.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingError, match="exists"):
        recover(tmp_path / "bad.mcap", tmp_path / "good.mcap")
    assert (tmp_path / "good.mcap").read_bytes() == b"mine"
