import json
import time

import numpy as np
import pytest
from mcap.writer import Writer

from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, Chirp
from ertis_driver.device import Settings
from ertis_driver.errors import (
    DeviceLost,
    DeviceTimeout,
    EndOfRecording,
    NotConfigured,
    RecordingError,
)
from ertis_driver.firmware import PingRequest
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import (
    RecordingInfo,
    RecordingWriter,
    open_recording,
    read_recording,
)
from ertis_driver.replay_device import ReplayDevice
from ertis_driver.replay_source import ReplaySource

NUM_WORDS = 32_768
NUM_PINGS = 3
INFO = RecordingInfo(
    "sim", Chirp(f_start_hz=1e5 / 3), NUM_WORDS, 21.5, 40.0, "2.3.4", "sim:hall.yaml"
)
TRUTH = {"landmarks": [{"class": "r48", "range_m": 1.25}]}


def make_frame(index, num_words=NUM_WORDS):
    rng = np.random.default_rng(index)
    return PdmFrame(
        words=rng.integers(0, 2**32, num_words, dtype=np.uint32),
        ping_index=index,
        ping_time_ns=1_700_000_000_000_000_000 + index * 20_000_000,
        time_uncertainty_ns=1000 + index,
        active=index % 2 == 0,
    )


def write(path, info=INFO, num_pings=NUM_PINGS):
    with RecordingWriter(path, info) as writer:
        for index in range(num_pings):
            writer.write(make_frame(index, info.num_words), TRUTH if index == 1 else None)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write(tmp_path_factory.mktemp("recording") / "hall.mcap")


def read_until_error(path):
    """How many pings came, and the error, if any."""
    count, error = 0, None
    try:
        for ping in open_recording(path):
            assert ping.frame.ping_index == count
            np.testing.assert_array_equal(ping.frame.words, make_frame(count).words)
            count += 1
    except RecordingError as caught:
        error = caught
    if error is not None:
        assert "\n" not in str(error)
        assert str(path) in str(error)
    return count, error


def assert_same(frame, expected):
    np.testing.assert_array_equal(frame.words, expected.words)
    assert frame.words.dtype == np.uint32
    for name in ("ping_index", "ping_time_ns", "time_uncertainty_ns", "active"):
        assert getattr(frame, name) == getattr(expected, name)


def test_a_recording_reads_back_as_it_was_written(recording):
    opened = read_recording(recording)
    assert opened.info == INFO
    pings = list(opened)
    for index, ping in enumerate(pings):
        assert_same(ping.frame, make_frame(index))
    assert [ping.truth for ping in pings] == [None, TRUTH, None]
    assert [(p.temperature_c, p.humidity_percent) for p in pings] == [(21.5, 40.0)] * 3
    assert len(list(opened)) == NUM_PINGS, "it can be read again"


def test_what_is_not_known_stays_unknown(tmp_path):
    info = RecordingInfo("live", None, NUM_WORDS)
    assert open_recording(write(tmp_path / "a.mcap", info)).info == info


def test_the_air_can_change_from_ping_to_ping(tmp_path):
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        writer.write(make_frame(0), temperature_c=-3.25, humidity_percent=81.5)
    ping = next(iter(read_recording(tmp_path / "a.mcap")))
    assert (ping.temperature_c, ping.humidity_percent) == (-3.25, 81.5)


def test_a_recording_without_pings_is_one(tmp_path):
    assert list(open_recording(write(tmp_path / "a.mcap", num_pings=0))) == []


def test_an_existing_file_is_not_overwritten(recording):
    before = recording.read_bytes()
    with pytest.raises(RecordingError, match="exists"):
        RecordingWriter(recording, INFO)
    assert recording.read_bytes() == before


def test_a_frame_of_another_length_is_refused(tmp_path):
    with (
        RecordingWriter(tmp_path / "a.mcap", INFO) as writer,
        pytest.raises(RecordingError, match="expected"),
    ):
        writer.write(make_frame(0, 65_536))


@pytest.mark.parametrize("truth", [{"range_m": float("nan")}, {"what": object()}])
def test_a_truth_that_is_no_json_is_refused_and_nothing_of_it_written(tmp_path, truth):
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        with pytest.raises(RecordingError, match="JSON"):
            writer.write(make_frame(0), truth)
        writer.write(make_frame(0))
    assert len(list(read_recording(tmp_path / "a.mcap"))) == 1


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(RecordingError, match="No such file"):
        RecordingWriter(tmp_path / "no" / "a.mcap", INFO)


def test_pings_are_on_disk_before_the_writer_closes(tmp_path):
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, INFO) as writer:
        for index in range(NUM_PINGS):
            writer.write(make_frame(index))
            count, error = read_until_error(path)
            assert count == index + 1
            assert "cut off" in str(error)


def test_a_file_cut_anywhere_gives_its_whole_pings_and_then_one_error(recording, tmp_path):
    whole = recording.read_bytes()
    path = tmp_path / "cut.mcap"
    points = {*range(1, 40), *range(200, len(whole), 9973), *range(len(whole) - 40, len(whole))}
    counts = []
    for point in sorted(points):
        path.write_bytes(whole[:point])
        count, error = read_until_error(path)
        assert error is not None, point
        assert "cut off" in str(error), (point, error)
        assert count >= point // (4 * NUM_WORDS + 4000), point
        counts.append(count)
    assert counts == sorted(counts)
    assert counts[-1] == NUM_PINGS


def test_one_flipped_bit_anywhere_is_one_error_and_never_a_wrong_ping(tmp_path):
    whole = write(tmp_path / "a.mcap", num_pings=1).read_bytes()
    path = tmp_path / "flipped.mcap"
    rng = np.random.default_rng(7)
    # Mostly head and tail, where structure is, and samples of the rest.
    head = whole.index(b"pdm") + 40
    points = [*range(0, head, 2), *range(len(whole) - 1200, len(whole), 4)]
    points += rng.integers(head, len(whole), 150).tolist()
    for point in points:
        flipped = bytearray(whole)
        flipped[point] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        _, error = read_until_error(path)
        assert error is not None, point


def test_damaged_metadata_is_noticed_before_the_first_ping(recording, tmp_path):
    damaged = recording.read_bytes().replace(b"21.5", b"31.5", 1)
    (tmp_path / "a.mcap").write_bytes(damaged)
    with pytest.raises(RecordingError, match="checksum of the metadata"):
        open_recording(tmp_path / "a.mcap")


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.mcap", b"", "is empty"),
        ("a.mcap", b"RIFF" + bytes(400_000), "not an MCAP file"),
        ("a.mcap", bytes(4 * 163_840), "not an MCAP file"),
        ("a.bin", b"", "0 bytes"),
        ("a.bin", bytes(4 * 32_768 - 1), "131071 bytes"),
        ("a.bin", bytes(4 * 163_840 + 4), "131072 bytes"),
        ("notes.txt", b"hello", "5 bytes"),
    ],
)
def test_a_foreign_file_is_refused_with_what_was_expected(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(RecordingError, match=words) as caught:
        open_recording(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_somebody_elses_mcap_is_no_recording(tmp_path):
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("chatter", "json", 0)
        writer.add_message(channel, 0, json.dumps({}).encode(), 0)
        writer.finish()
    with pytest.raises(RecordingError, match="no sonar recording"):
        open_recording(tmp_path / "a.mcap")


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(RecordingError, match="no recording"):
        open_recording(tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match="directory"):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("num_words", "pings", "each"),
    [(163_840, 1, 163_840), (327_680, 2, 163_840), (65_536, 1, 65_536)],
)
def test_headerless_words_are_pings(tmp_path, num_words, pings, each):
    words = np.arange(num_words, dtype=np.uint32)
    (tmp_path / "a.bin").write_bytes(words.astype("<u4").tobytes())
    recording = open_recording(tmp_path / "a.bin")
    assert recording.info == RecordingInfo("replay", None, each)
    found = [ping.frame for ping in recording]
    np.testing.assert_array_equal(np.concatenate([frame.words for frame in found]), words)
    assert [frame.ping_index for frame in found] == list(range(pings))


def test_a_replay_plays_to_its_end_with_the_recorded_settings(recording):
    with ReplayDevice(recording) as device:
        assert (device.info.source, device.info.firmware, device.is_live) == ("sim", "2.3.4", False)
        with pytest.raises(NotConfigured):
            device.ping()
        device.configure(Settings(INCUMBENT_CHIRP))
        assert device.settings == Settings(INFO.chirp, NUM_WORDS)
        for index in range(NUM_PINGS):
            assert_same(device.ping(), make_frame(index))
        with pytest.raises(EndOfRecording):
            device.ping()
    device.close()
    with pytest.raises(DeviceLost):
        device.ping()


@pytest.mark.parametrize(
    ("recorded", "played"), [("live", "replay"), ("replay", "replay"), ("sim", "sim")]
)
def test_a_replay_never_claims_to_be_live(tmp_path, recorded, played):
    path = write(tmp_path / "a.mcap", RecordingInfo(recorded, DEFAULT_CHIRP, NUM_WORDS))
    with ReplayDevice(path) as device:
        assert device.info.source == played
    assert ReplaySource(path).mark == played


def test_a_replay_of_headerless_words_takes_the_chirp_it_is_told(tmp_path):
    (tmp_path / "a.bin").write_bytes(bytes(4 * 32_768))
    with ReplayDevice(tmp_path / "a.bin") as device:
        assert device.settings is None
        device.configure(Settings(INCUMBENT_CHIRP))
        assert device.settings == Settings(INCUMBENT_CHIRP, 32_768)
        assert device.ping().words.shape == (32_768,)


def test_a_replay_in_real_time_keeps_the_pace(recording):
    with ReplayDevice(recording, rate=1.0) as device:
        device.configure(Settings())
        device.ping()
        start = time.monotonic()
        device.ping()
        device.ping()
        assert time.monotonic() - start >= 0.03


def test_waiting_for_a_recorded_ping_neither_loses_nor_hurries_it(recording):
    with ReplayDevice(recording, rate=1.0) as device:
        device.configure(Settings())
        assert device.wait_frame(5.0).ping_index == make_frame(0).ping_index
        with pytest.raises(DeviceTimeout, match="wait again"):
            device.wait_frame(0.001)
        assert_same(device.wait_frame(5.0), make_frame(1))


def test_a_recording_keeps_the_pdm_clock_and_steps_of_the_host_clock(tmp_path):
    info = RecordingInfo("live", DEFAULT_CHIRP, 32_768, pdm_rate_hz=1_125_000)
    words = np.zeros(32_768, np.uint32)
    with RecordingWriter(tmp_path / "a.mcap", info) as writer:
        writer.write(PdmFrame(words, 0, 0, pdm_rate_hz=1_125_000, clock_step_ns=-5))
        with pytest.raises(RecordingError, match="frame at 4500000 Hz, expected 1125000"):
            writer.write(PdmFrame(words, 1, 0))
    (ping,) = read_recording(tmp_path / "a.mcap")
    assert (ping.frame.pdm_rate_hz, ping.frame.clock_step_ns) == (1_125_000, -5)
    with ReplayDevice(tmp_path / "a.mcap") as device:
        assert device.settings == Settings(DEFAULT_CHIRP, 32_768, 1_125_000)


def test_a_replay_source_cycles_cuts_and_refuses_to_pad(tmp_path):
    path = write(tmp_path / "a.mcap", RecordingInfo("live", None, 65_536), num_pings=2)
    source = ReplaySource(path)
    codes = np.zeros(64, np.uint16)
    for index in (0, 1, 0):
        words = source.next_frame(PingRequest(0, 65_536, codes, 450_000, True))
        np.testing.assert_array_equal(words, make_frame(index, 65_536).words)
    cut = source.next_frame(PingRequest(0, 32_768, codes, 450_000, True))
    np.testing.assert_array_equal(cut, make_frame(1, 65_536).words[:32_768])
    with pytest.raises(RecordingError, match="asked for"):
        source.next_frame(PingRequest(0, 98_304, codes, 450_000, True))
    with pytest.raises(RecordingError, match="recorded at 4500000 Hz"):
        source.next_frame(PingRequest(0, 32_768, codes, 450_000, True, pdm_rate_hz=1_125_000))
