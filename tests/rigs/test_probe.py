import json

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.emulator import Emulator
from ertis_driver.errors import RecordingError
from ertis_driver.frame import PdmFrame
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.dataset import random_scene

NUM_WORDS = 163_840


@pytest.fixture(scope="module")
def frames():
    """What one simulated sonar hears: passive, with the default chirp, and with that reversed."""
    scene, samples = random_scene(6, 1), DEFAULT_CHIRP.samples(450e3)
    kinds = {"passive": None, "active": samples, "backward": samples[::-1].copy()}
    return {name: scene.hear(0, NUM_WORDS, chirp) for name, chirp in kinds.items()}


class Scripted:
    """Plays ``change(index, active, frame)`` of what a healthy sonar would hear."""

    def __init__(self, frames, change=None):
        self.frames, self.change = frames, change
        self.emulator = None

    def next_frame(self, request):
        words = self.frames["active" if request.active else "passive"]
        if self.change:
            words = self.change(self, request, words)
        return words


@pytest.fixture
def probe(frames, capsys):
    """Run ``ertis probe`` on an emulator that plays a script: exit code, stdout, stderr."""

    def run(change=None, *flags, mark="sim", pings=3):
        source = Scripted(frames, change)
        with Emulator(source, mark=mark) as emulator:
            source.emulator = emulator
            code = main(["probe", f"serial:{emulator.path}", "--pings", str(pings), *flags])
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


def test_a_healthy_sonar_is_called_so(probe):
    code, out, err = probe()
    assert code == 0, out
    assert err == ""
    lines = out.splitlines()
    assert lines[-1] == "healthy"
    assert lines[0].startswith("sonar        serial:/dev/pts/")
    assert lines[0].endswith(", simulated")
    assert lines[1] == "firmware     2.3.4"
    assert "frames 7.3 ms to 3.73 s, DAC 160 to 2000 kHz, chirps 0.14 to 146 ms" in lines[2]
    assert "chirp hyperbolic:80000:20000:0.0025" in lines[3]
    assert "3 active, 1 passive; " in lines[4]
    assert "heard in 3 of 3: after 0.1" in lines[5]
    assert "-55." in lines[6]
    assert "until 1." in lines[7] or "until 0." in lines[7]
    assert "mended in 4 pings" in lines[8]
    assert lines[9] == "microphones  0 ........ ........ ........ ........ 31   . ok"
    assert max(len(line) for line in lines) < 120


def test_as_json_it_is_one_object(probe):
    code, out, _ = probe(None, "--json")
    assert code == 0
    (line,) = out.splitlines()
    told = json.loads(line)
    assert (told["source"], told["firmware"], told["healthy"]) == ("sim", "2.3.4", True)
    assert told["limits"]["num_words"] == [32_768, 16_777_216]
    assert told["settings"]["chirp"] == DEFAULT_CHIRP.name
    assert (told["active_pings_heard"], told["passive_pings_heard"]) == (3, 1)
    assert told["pings_per_s"] > 0
    assert [path["heard"] for path in told["direct_paths"]] == [True] * 3
    assert told["passive"]["states"] == told["active"]["states"] == ["ok"] * 32
    assert told["passive"]["level_dbfs"] < told["active"]["level_dbfs"]
    assert told["findings"] == told["faulty_microphones"] == []


def stuck(mic):
    return lambda source, request, words: words | np.uint32(1 << mic)


def test_a_stuck_microphone_is_named_by_row_and_place(probe):
    code, out, _ = probe(stuck(16))
    assert code == 3
    lines = out.splitlines()
    assert lines[9] == "microphones  0 ........ ........ S....... ........ 31   . ok, S stuck"
    (finding,) = [line for line in lines if line.startswith("- ")]
    assert finding.startswith("- microphone 16 (7 mm left, 19 mm below): stuck: its bit never")
    assert finding.endswith("in 4 of 4 pings")
    assert lines[-1] == "works, with 1 finding"


def test_a_loose_contact_in_one_ping_is_found(probe):
    def change(source, request, words):
        words = words.copy()
        if request.index == 2:
            words[50_000:51_000] |= np.uint32(1 << 30)
        return words

    code, out, _ = probe(change, "--json")
    assert code == 3
    (faulty,) = json.loads(out)["faulty_microphones"]
    assert faulty == {"row": 30, "state": "interrupted", "pings": 1}


def test_two_microphones_on_one_line_name_each_other(probe):
    def change(source, request, words):
        return words & ~np.uint32(1 << 9) | (words >> np.uint32(8) & np.uint32(1)) << np.uint32(9)

    code, out, _ = probe(change)
    assert code == 3
    assert "twin: the bits of microphone 9:" in out
    assert "twin: the bits of microphone 8:" in out


def test_silence_instead_of_a_direct_path_is_found(probe):
    code, out, _ = probe(lambda source, request, words: source.frames["passive"])
    assert code == 3
    assert "direct path  not heard" in out
    assert "no direct path in 3 of 3 active pings: the chirp was not emitted" in out
    assert out.count("\n- ") == 1


def test_a_chirp_in_the_passive_ping_is_found(probe):
    code, out, _ = probe(lambda source, request, words: source.frames["active"])
    assert code == 3
    assert "the passive ping heard a chirp: try the other trigger form" in out
    assert out.count("\n- ") == 1


def test_a_reversed_chirp_is_found(probe):
    def change(source, request, words):
        return source.frames["backward"] if request.active else words

    code, out, _ = probe(change)
    assert code == 3
    assert "the chirp came backward in 3 of 3 active pings" in out
    assert out.count("\n- ") == 1


def test_bits_that_no_microphone_made_are_found(probe):
    def change(source, request, words):
        return np.random.default_rng(request.index).integers(0, 2**32, words.size, dtype=np.uint32)

    code, out, _ = probe(change)
    assert code == 3
    assert "these are no microphones' bits" in out


def test_a_blast_long_after_the_chirp_is_found(probe):
    def change(source, request, words):
        words = words.copy()
        words[90_000:90_200] &= ~np.uint32(1 << 11)
        return words

    code, out, _ = probe(change)
    assert code == 3
    assert "microphone 11 " in out
    assert "saturated when no direct path explains it, in 4 of 4 pings" in out


def test_pings_of_another_client_are_counted(probe):
    def change(source, request, words):
        if request.index == 2:
            source.emulator.state.ping_index = 7
        return words

    code, out, _ = probe(change, "--json")
    assert code == 3
    assert json.loads(out)["pings_skipped"] == 4
    assert "passed over 4" in json.loads(out)["findings"][0]


def test_a_ping_that_never_comes_is_a_finding_and_not_counted_twice(probe):
    def change(source, request, words):
        if request.index == 1:
            raise RecordingError("nothing to play")
        return words

    code, out, _ = probe(change, "--json", pings=2)
    assert code == 3
    told = json.loads(out)
    assert (told["pings_failed"], told["pings_skipped"]) == (1, 0)
    (finding,) = told["findings"]
    assert finding.startswith("1 of 3 pings failed: no frame from /dev/pts/")


def error_of(capsys):
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    return line


def test_a_dead_port_is_one_line_and_exit_code_1(bare_pty, capsys):
    assert main(["probe", f"serial:{bare_pty.path}"]) == 1
    assert f"no answer in 1 s at {bare_pty.path}" in error_of(capsys)


def test_a_missing_port_is_one_line_and_exit_code_1(tmp_path, capsys):
    assert main(["probe", f"serial:{tmp_path}/ttyACM0", "--json"]) == 1
    assert "check cable" in error_of(capsys)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--pings", "0"], "--pings 0, expected 1 to 10000"),
        (["--chirp", "linear:90000:20000:0.1"], "--chirp of 0.1 s, expected no more than"),
        (["--chirp", "loud"], "chirp 'loud', expected kind:"),
    ],
)
def test_wrong_wishes_are_refused_before_anything_is_opened(tmp_path, capsys, flags, said):
    assert main(["probe", f"serial:{tmp_path}/ttyACM0", *flags]) == 1
    assert said in error_of(capsys)


def recorded(path, chirp, *frames, **info):
    with RecordingWriter(path, RecordingInfo("live", chirp, NUM_WORDS, **info)) as writer:
        for index, (words, active) in enumerate(frames):
            writer.write(PdmFrame(words, index, index * 100_000_000, 0, active))
    return f"replay:{path}"


def test_a_recording_is_probed_as_far_as_it_goes(frames, tmp_path, capsys):
    pings = [(frames["active"], True), (frames["passive"], False), (frames["active"], True)]
    assert main(["probe", recorded(tmp_path / "a.mcap", DEFAULT_CHIRP, *pings)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("a.mcap, a replayed recording")
    assert lines[4] == "pings        2 active, 1 passive"


def test_an_emulated_recording_is_searched_for_the_chirp_that_was_recorded(capsys, frames):
    old = random_scene(6, 1).hear(0, NUM_WORDS, INCUMBENT_CHIRP.samples(450e3))
    source = Scripted(frames, lambda s, request, words: old if request.active else words)
    with Emulator(source, mark="replay") as emulator:
        assert main(["probe", f"serial:{emulator.path}", "--pings", "1"]) == 0
    assert f"recorded with {INCUMBENT_CHIRP.name}" in capsys.readouterr().out


def test_an_empty_recording_is_one_line_and_exit_code_1(tmp_path, capsys):
    assert main(["probe", recorded(tmp_path / "a.mcap", DEFAULT_CHIRP)]) == 1
    assert "no more pings" in error_of(capsys)


def test_a_recording_of_audible_sound_is_refused(tmp_path, capsys):
    address = recorded(tmp_path / "a.mcap", DEFAULT_CHIRP, pdm_rate_hz=1_125_000)
    assert main(["probe", address]) == 1
    assert "1125000 Hz, expected 4500000: only ultrasound" in error_of(capsys)


def test_a_scene_is_said_to_be_simulated(tmp_path, capsys):
    scene = tmp_path / "room.yaml"
    scene.write_text("seed: 3\nroom: {x_m: [-1, 3], y_m: [-2, 2]}\n")
    assert main(["probe", f"sim:{scene}", "--pings", "1"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"sonar        sim:{scene}, simulated"
