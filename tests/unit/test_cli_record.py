"""``ertis record``, ``info``, ``recover``, ``replay`` and ``convert`` as their users call them."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from test_recording import INFO, NUM_WORDS, TRUTH, make_frame

from ertis_daemon.cli import main
from ertis_driver.mcap_reader import read_entries
from ertis_driver.recording import RecordingInfo, RecordingWriter, open_recording

NUM_PINGS = 6
EVENT = {
    "ping_index": 3,
    "ping_time_ns": 5,
    "device": "ertis",
    "source": "sim",
    "model": "m",
    "landmarks": [
        {"track_id": 1, "state": "new", "class": "r48", "probabilities": {"r48": 0.75}}
        | {"range_m": 2.0, "azimuth_rad": np.pi / 6, "elevation_rad": None, "snr_db": 20.5}
        | {"radius_m": 0.048}
    ],
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "hall.mcap"
    with RecordingWriter(path, INFO) as writer:
        for index in range(NUM_PINGS):
            writer.write(make_frame(index + (index > 2)), TRUTH)
            writer.write_event(json.dumps(EVENT).encode(), make_frame(index).ping_time_ns)
    return path


def run_json(capsys, *argv):
    """Exit code and the object printed."""
    code = main([*map(str, argv), "--json"])
    return code, json.loads(capsys.readouterr().out)


def record(capsys, recording, output, *more):
    address = f"replay:{recording}"
    return run_json(capsys, "record", output, "--address", address, "--no-pictures", *more)


def test_a_recording_keeps_frames_times_and_who_and_where(recording, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    told = ("--who", "Ada", "--where", "hall", "--note", "try", "--licence", "CC0")
    air = ("--temperature-c", "18.5", "--humidity-percent", "61")
    code, said = record(capsys, recording, out, *told, *air)
    assert (said["pings"], said["pings_lost"]) == (NUM_PINGS, 1)
    assert code == 3, "a lost ping is loss"
    assert said["ended"] == "end of the recording played"
    opened = open_recording(out)
    info = opened.info
    assert (info.operator, info.place, info.note, info.licence) == ("Ada", "hall", "try", "CC0")
    assert (info.source, info.chirp, info.temperature_c) == ("sim", INFO.chirp, 18.5)
    assert info.humidity_percent == 61
    assert info.started
    for ours, theirs in zip(opened, open_recording(recording), strict=True):
        np.testing.assert_array_equal(ours.frame.words, theirs.frame.words)
        assert ours.frame.ping_time_ns == theirs.frame.ping_time_ns
    logs = [e for e in read_entries(out) if e.channel.topic == "log"]
    assert any(b"1 pings lost before 4" in bytes(entry.message.data) for entry in logs)


def test_it_ends_after_so_many_pings_or_so_much_time(recording, tmp_path, capsys):
    assert record(capsys, recording, tmp_path / "a.mcap", "-n", "3")[1]["pings"] == 3
    loop = f"{recording}?loop=1"
    code, said = record(capsys, loop, tmp_path / "b.mcap", "-t", "300ms", "--rate", "20")
    assert said["seconds"] >= 0.3
    assert said["ended"] == "asked"
    assert code == 3, "the gap in what was played comes round again"


def test_a_split_recording_is_several_recordings(recording, tmp_path, capsys):
    options = ("--split", "600kB", "--compress")
    _, said = record(capsys, recording, tmp_path / "a.mcap", *options)
    names = [f"{tmp_path}/a_{part:03d}.mcap" for part in (1, 2)]
    assert said["files"] == names
    pings = [list(open_recording(name)) for name in names]
    assert sum(map(len, pings)) == NUM_PINGS
    assert [open_recording(name).info.part for name in names] == [1, 2]
    assert all(os.path.getsize(name) <= 600_000 for name in names)  # noqa: PTH202


def test_a_recording_has_pictures_and_is_told_of_dead_microphones(tmp_path, capsys):
    from ertis_simulator.dataset import random_scene

    words = random_scene(5, 3).hear(0, 163_840, INFO.chirp.samples(450e3))
    words &= ~np.uint32(1 << 7)
    with RecordingWriter(tmp_path / "a.mcap", RecordingInfo("sim", INFO.chirp, 163_840)) as writer:
        frame = make_frame(0, 163_840)
        frame.words[...] = words
        writer.write(frame)
    code, said = run_json(
        capsys, "record", tmp_path / "b.mcap", "--address", f"replay:{tmp_path}/a.mcap"
    )
    assert code == 0
    assert said["faulty_microphones"] == [{"row": 7, "state": "stuck"}]
    found = {e.channel.topic: bytes(e.message.data) for e in read_entries(tmp_path / "b.mcap")}
    assert b"\x89PNG\r\n" in found["picture"]
    assert b"microphone 7 stuck" in found["log"]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["-n", "0"], "--pings 0"),
        (["--rate", "-1"], "--rate -1"),
        (["--words", "100"], "num_words 100"),
        (["--temperature-c", "200"], "--temperature-c 200"),
        (["--humidity-percent", "101"], "--humidity-percent 101"),
        (["--split", "1kB"], "two pings"),
        (["--note", "x" * 2001], "note of 2001 characters"),
    ],
)
def test_a_wrong_wish_is_one_line_and_leaves_no_file(recording, tmp_path, capsys, argv, words):
    out = tmp_path / "a.mcap"
    assert main(["record", str(out), "--address", f"replay:{recording}", *argv]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert words in lines[0]
    assert not list(tmp_path.iterdir())


def test_a_folder_named_as_output_makes_no_file_beside_it(recording, tmp_path, capsys):
    folder = tmp_path / "night"
    folder.mkdir()
    assert main(["record", str(folder), "--address", f"replay:{recording}"]) == 1
    said = f"ertis: cannot write {folder}: name a file in a folder that exists"
    assert capsys.readouterr().err.splitlines() == [said]
    assert list(tmp_path.iterdir()) == [folder]


def ertis(*argv, **options):
    command = [sys.executable, "-m", "ertis_daemon.cli", *map(str, argv)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def test_ctrl_c_closes_the_file(recording, tmp_path):
    out = tmp_path / "a.mcap"
    with ertis("record", out, "--address", f"replay:{recording}?loop=1", "--rate", "50") as process:
        wait_for(lambda: out.exists() and out.stat().st_size > 400_000)
        process.send_signal(signal.SIGINT)
        assert process.wait(20) in (3, 130)
    pings = list(open_recording(out))
    assert len(pings) >= 3


def wait_for(condition, timeout_s=60.0):
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_a_full_disk_ends_the_recording_with_loss_and_a_whole_file(recording, tmp_path):
    import resource

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))

    out = tmp_path / "a.mcap"
    address = f"replay:{recording}?loop=1"
    done = subprocess.run(
        [sys.executable, "-m", "ertis_daemon.cli", "record", out, "--address", address],
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=limit,
        check=False,
    )
    assert done.returncode == 3, done.stderr
    assert "free some space; what was written before is kept and readable" in done.stderr
    assert len(list(open_recording(out))) == 7


def test_info_says_what_is_in_it(recording, capsys):
    code, said = run_json(capsys, "info", recording)
    assert code == 0
    assert (said["pings"], said["checked"], said["pings_lost"]) == (NUM_PINGS, False, None)
    assert said["messages"]["events"] == NUM_PINGS
    assert said["source"] == "sim"
    assert len(said["mic_positions_m"]) == 32
    code, said = run_json(capsys, "info", recording, "--check")
    assert (code, said["checked"], said["pings_lost"], said["damage"]) == (0, True, 1, None)
    assert main(["info", str(recording)]) == 0
    text = capsys.readouterr().out
    assert "sim: simulated, not heard" in text
    assert "6 truth, 6 events" in text


def test_info_finds_damage_where_it_is(recording, tmp_path, capsys):
    offset = [e.offset for e in read_entries(recording) if e.channel.topic == "pdm"][2]
    damaged = bytearray(recording.read_bytes())
    damaged[offset + 5000] ^= 1
    (tmp_path / "bad.mcap").write_bytes(damaged)
    code, said = run_json(capsys, "info", tmp_path / "bad.mcap", "--check")
    assert code == 3
    assert (said["damage"]["offset"], said["damage"]["pings_before"]) == (offset, 2)
    assert not said["damage"]["cut"]


def test_info_reads_all_of_a_recording_without_an_end(recording, tmp_path, capsys):
    (tmp_path / "cut.mcap").write_bytes(recording.read_bytes()[:500_000])
    code, said = run_json(capsys, "info", tmp_path / "cut.mcap")
    assert (code, said["closed"], said["checked"], said["pings"]) == (3, False, True, 3)
    assert said["damage"]["cut"]


def test_recover_counts_what_was_lost_and_says_3(recording, tmp_path, capsys):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(recording.read_bytes()[:500_000])
    code, said = run_json(capsys, "recover", bad)
    assert code == 3
    assert (said["num_pings"], said["pings_lost"]) == (3, 1)
    assert said["output"] == str(tmp_path / "bad.recovered.mcap")
    assert main(["info", said["output"], "--check"]) == 0
    capsys.readouterr()
    code, said = run_json(capsys, "recover", recording, "-o", tmp_path / "same.mcap")
    assert (code, said["num_pings"], said["bytes_lost"]) == (0, NUM_PINGS, 0)


def test_raw_words_go_in_and_out(tmp_path, capsys):
    words = np.random.default_rng(1).integers(0, 2**32, 2 * 163_840, dtype=np.uint32)
    for number in range(2):
        words[163_840 * number :][:163_840].astype("<u4").tofile(tmp_path / f"{number}.bin")
    files = [tmp_path / "0.bin", tmp_path / "1.bin"]
    chirp = ("--chirp", "hyperbolic:50000:25000:0.0025")
    code, said = run_json(capsys, "convert", *files, tmp_path / "a.mcap", *chirp, "--compress")
    assert (code, said["pings"]) == (0, 2)
    opened = open_recording(tmp_path / "a.mcap")
    assert opened.info.chirp.name == "hyperbolic:50000:25000:0.0025"
    assert [ping.frame.ping_index for ping in opened] == [0, 1]
    assert main(["convert", str(tmp_path / "a.mcap"), str(tmp_path / "back.bin")]) == 0
    assert (tmp_path / "back.bin").read_bytes() == words.astype("<u4").tobytes()
    lost = "back.bin holds words only: chirp, times, temperature and source (replay) stay behind"
    assert lost in capsys.readouterr().err
    assert (
        main(["convert", str(tmp_path / "a.mcap"), str(tmp_path / "1b.bin"), "--pings", "1"]) == 0
    )
    assert (tmp_path / "1b.bin").read_bytes() == (tmp_path / "1.bin").read_bytes()


def test_events_become_a_table(recording, tmp_path, capsys):
    out = tmp_path / "events.csv"
    code, said = run_json(capsys, "convert", recording, out)
    assert (code, said["landmarks"]) == (0, NUM_PINGS)
    head, first, *_ = out.read_text().splitlines()
    row = dict(zip(head.split(","), first.split(","), strict=True))
    assert row["class"] == "r48"
    assert (row["probability"], row["azimuth_deg"], row["elevation_deg"]) == ("0.75", "30.0", "")


def test_a_table_of_a_damaged_recording_is_none(recording, tmp_path, capsys):
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(recording.read_bytes()[:-400_000])
    out = tmp_path / "events.csv"
    assert main(["convert", str(torn), str(out)]) == 1
    assert "torn.mcap" in capsys.readouterr().err
    assert list(tmp_path.glob("events.csv*")) == []


def test_a_wav_holds_the_audio_of_each_ping(recording, tmp_path, capsys):
    from scipy.io import wavfile

    from ertis_driver.audio import PdmDecoder, whole_samples

    out = tmp_path / "a.wav"
    assert main(["convert", str(recording), str(out), "--pings", "1:3"]) == 0
    rate_hz, samples = wavfile.read(out)
    assert (rate_hz, samples.dtype, samples.shape[1]) == (450_000, np.float32, 32)
    heard = [
        PdmDecoder().decode(whole_samples(ping.frame.words)).audio.T
        for ping in list(open_recording(recording))[1:3]
    ]
    np.testing.assert_array_equal(samples, np.concatenate(heard))
    assert b"simulated" in out.read_bytes()


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["out.ogg"], "unknown suffix"),
        (["out.bin"], "a headerless file does not say"),
        (["out.wav", "--compress"], "--compress is for .mcap"),
        (["out.wav", "--pings", "5:2"], "--pings 5:2"),
        (["out.wav", "--pings", "70:"], "no ping from 70"),
    ],
)
def test_a_conversion_that_cannot_be_is_one_line_and_leaves_nothing(
    recording, tmp_path, capsys, argv, words
):
    name, *more = argv
    assert main(["convert", str(recording), str(tmp_path / name), *more]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert words in lines[0]
    assert not list(tmp_path.iterdir())


def test_a_recording_without_events_makes_no_table(tmp_path, capsys):
    with RecordingWriter(tmp_path / "a.mcap", INFO) as writer:
        writer.write(make_frame(0))
    assert main(["convert", str(tmp_path / "a.mcap"), str(tmp_path / "e.csv")]) == 1
    assert "holds no events" in capsys.readouterr().err
    assert not (tmp_path / "e.csv").exists()


@pytest.mark.parametrize("command", ["info", "recover", "replay", "convert"])
@pytest.mark.parametrize("content", [None, b"", b"hello", b"\x89MCAP0\r\n" + bytes(100)])
def test_a_foreign_file_is_one_clear_line(tmp_path, capsys, command, content):
    path = tmp_path / "x.mcap"
    if content is not None:
        path.write_bytes(content)
    more = [str(tmp_path / "y.wav")] if command == "convert" else []
    assert main([command, str(path), *more]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    assert "x.mcap" in lines[0]


@pytest.mark.parametrize(
    "argv", [["emulate", "--replay", "{}", "--link"], ["replay", "{}", "--to", "pty", "--link"]]
)
def test_an_emulated_sonars_link_replaces_no_file(recording, tmp_path, capsys, argv):
    argv = [word.format(recording) for word in argv]
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    for path, said in (
        (mine, f"{mine} is no link and is left alone: name another"),
        (tmp_path, f"{tmp_path} is no link and is left alone: name another"),
        (tmp_path / "no" / "port", f"cannot make the link {tmp_path}/no/port: No such file"),
    ):
        assert main([*argv, str(path)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"ertis: {said}")
    assert mine.read_text() == "mine"


def test_a_replayed_sonar_hears_the_recording_and_ends_after_it(recording):
    from ertis_driver.device import Settings
    from ertis_driver.errors import DeviceError
    from ertis_driver.open import open_device

    with ertis("replay", recording, "--to", "pty", "--rate", "2") as process:
        port = process.stdout.readline().decode().strip()
        with open_device(f"serial:{port}") as sonar:
            sonar.configure(Settings(num_words=NUM_WORDS))
            assert sonar.info.source == "sim"
            assert sonar.info.firmware == "2.3.4"
            for ping in open_recording(recording):
                np.testing.assert_array_equal(sonar.ping().words, ping.frame.words)
            with pytest.raises(DeviceError):
                sonar.ping()
        assert process.wait(20) == 0
