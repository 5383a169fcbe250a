"""The incumbent client, unmodified, against our emulator; and our driver against what it sends."""

import numpy as np
import pytest
from rtisdev_rig.driven import DrivenClient
from wiretap import Wiretap

from ertis_driver import protocol
from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.device import Settings
from ertis_driver.emulator import Emulator
from ertis_driver.ertis_device import open_serial

pytestmark = pytest.mark.index
NUM_WORDS = 32_768
SHORT = {  # 91 samples: it sleeps 1 ms after each
    "microphoneSamples": NUM_WORDS,
    "callDuration": 0.2,
    "callMinimumFrequency": 30_000,
    "callMaximumFrequency": 60_000,
}


@pytest.fixture(scope="module", params=["linux", "windows"])
def platform(request):
    return request.param


@pytest.fixture(scope="module")
def start_client(platform, rtisdev_folder, tmp_path_factory):
    clients = []

    def start():
        clients.append(DrivenClient(platform, rtisdev_folder, tmp_path_factory.mktemp("client")))
        return clients[-1]

    yield start
    for client in clients:
        client.close()


@pytest.fixture(scope="module")
def client(start_client):
    return start_client()


@pytest.fixture
def emulator(source, platform):
    with Emulator(source, trigger_form=platform) as emulator:
        yield emulator


@pytest.fixture
def connected(client, emulator):
    """The client, connected to the emulator."""
    assert client.call("open_connection", emulator.path) is True
    yield client
    client.call("close_connection")


def assert_is_ping(measured, source, index, *, active, num_words=NUM_WORDS):
    assert (measured["index"], measured["active"]) == (index, active)
    assert measured["words"].dtype == np.uint32
    np.testing.assert_array_equal(measured["words"], source.words(index, num_words, active=active))


def told_codes(client, name):
    """The DAC codes of a chirp as the client has it: floor(2047 s + 2048)."""
    samples = client.call("get_current_settings", name)["chirp"]
    return np.floor(2047 * samples + 2048).astype(np.uint16)


def test_it_reads_the_version_and_is_blind_to_our_mark(connected):
    assert connected.call("get_firmware_version") == "v2.3.4"


def test_its_pings_are_what_was_played_and_the_firmware_holds_what_it_was_told(connected, source):
    name = connected.call(
        "set_recording_settings",
        **(SHORT | {"microphoneSamples": 65_536, "callSampleFrequency": 500_000}),
        callEmissions=3,
    )
    for index, active in enumerate([True, False, True]):
        measured = connected.call("get_raw_measurement", active, name)
        assert_is_ping(measured, source, index, active=active, num_words=65_536)
        request = source.requests[-1]
        assert (request.index, request.active) == (index, active)
        assert (request.num_words, request.pdm_rate_hz) == (65_536, 4_500_000)
        assert (request.dac_rate_hz, request.emissions) == (500_000, 3)
        np.testing.assert_array_equal(request.dac_codes, told_codes(connected, name))
    assert len(request.dac_codes) == 101


def test_it_can_listen_with_the_audible_clock(connected, source):
    name = connected.call("set_recording_settings", **SHORT, microphoneSampleFrequency=1_125_000)
    assert_is_ping(connected.call("get_raw_measurement", False, name), source, 0, active=False)
    assert source.requests[-1].pdm_rate_hz == 1_125_000


def test_its_custom_call_is_what_the_firmware_holds(connected, source, tmp_path):
    samples = np.random.default_rng(3).uniform(-1, 1, 80)
    samples[:3] = -1, 0, 1
    np.savetxt(tmp_path / "call.csv", samples, delimiter=",")
    name = connected.call(
        "set_recording_settings", callCustom=str(tmp_path / "call.csv"), microphoneSamples=NUM_WORDS
    )
    assert_is_ping(connected.call("get_raw_measurement", True, name), source, 0, active=True)
    held = source.requests[-1].dac_codes
    np.testing.assert_array_equal(held, np.floor(2047 * samples + 2048))
    assert held[:3].tolist() == [1, 2048, 4095]


def test_it_sees_its_counter_wrap(connected, source):
    name = connected.call("set_recording_settings", **SHORT)
    assert connected.call("set_counter", 2**32 - 1) is True
    for index in (2**32 - 1, 0):
        measured = connected.call("get_raw_measurement", True, name)
        assert_is_ping(measured, source, index, active=True)


def test_a_second_client_setting_takes_effect_before_the_ping(connected, source):
    names = [
        connected.call("set_recording_settings", **(SHORT | {"callMaximumFrequency": top_hz}))
        for top_hz in (50_000, 60_000)
    ]
    for index, name in enumerate(names):
        assert_is_ping(
            connected.call("get_raw_measurement", True, name), source, index, active=True
        )
        np.testing.assert_array_equal(source.requests[-1].dac_codes, told_codes(connected, name))


@pytest.mark.parametrize("pin", [1, 2])
@pytest.mark.parametrize("active", [True, False])
def test_pings_triggered_from_outside_reach_it(connected, emulator, source, pin, active):
    name = connected.call("set_recording_settings", **SHORT)
    assert connected.call("set_behaviour", active) is True
    assert connected.call("toggle_external_triggers", True, pin) is True
    connected.listen(name)
    received = edges = 0
    while received < 3:
        assert edges < 9, f"{received} pings from {edges} edges"
        emulator.trigger(3 - pin)  # the other one does nothing
        emulator.trigger(pin)
        ping = connected.call("next_ping", 10.0)
        if ping is not None:  # between two pings it may clear its input, on a busy machine
            assert_is_ping(ping, source, edges, active=active)
            received += 1
        edges += 1
    connected.call("unlisten")
    assert connected.call("toggle_external_triggers", False, pin) is True
    emulator.trigger(pin)
    measured = connected.call("get_raw_measurement", True, name)
    assert_is_ping(measured, source, edges, active=True)
    assert len(source.requests) == edges + 1


def test_it_steps_the_amplifier_up_before_the_first_active_ping(start_client, emulator, source):
    client = start_client()
    client.call("open_connection", emulator.path)
    name = client.call("set_recording_settings", **SHORT)
    for active in (False, True):
        client.call("get_raw_measurement", active, name)
        assert source.requests[-1].amplified is active
    assert client.call("toggle_amplifier", False) is True
    client.call("get_raw_measurement", False, name)
    assert not source.requests[-1].amplified
    assert "Are you sure" not in client.log


def test_it_is_told_what_the_firmware_cannot_do(client, source, platform):
    with Emulator(source, trigger_form=platform, unsupported=("J", "K")) as emulator:
        client.call("open_connection", emulator.path)
        client.call("toggle_amplifier", True)
        client.call("toggle_external_triggers", True, 1)
        client.call("close_connection")
    assert client.log.count("Are you sure the RTIS device supports this feature?") == 2


VERSION = b"!Y,0,0,0\n"
RAMP_SAMPLES = 113  # of 1126 at either end: its Hann ramps stand half a sample off ours
RAMP_CODES = 22  # so much that is, at most, of 4095


def commands(sent):
    """Command by command, whether or not a newline ends them."""
    return [b"!" + command for command in sent.split(b"!")[1:]]


def codes(sent):
    """The chirp as uploaded."""
    values = [line.split(b",")[1:3] for line in commands(sent) if line.startswith(b"!C")]
    assert [int(index) for index, _ in values] == list(range(len(values)))
    return np.array([int(value) for _, value in values])


class Silence:
    def next_frame(self, request):
        return np.zeros(request.num_words, np.uint32)


@pytest.fixture(scope="module")
def both_said(client, platform):
    """What client and driver send for the same settings and samples, and to ping in both ways."""
    with Emulator(Silence(), trigger_form=platform) as emulator:
        with Wiretap(emulator.path) as tap:
            client.call("open_connection", tap.path)
            name = client.call("set_recording_settings", microphoneSamples=NUM_WORDS)
            client.call("get_raw_measurement", True, name)
            client.call("get_raw_measurement", False, name)
            chirp = CustomChirp.from_samples(client.call("get_current_settings", name)["chirp"])
            client.call("close_connection")
            its = bytes(tap.sent)
        with (
            Wiretap(emulator.path) as tap,
            open_serial(tap.path, trigger_form=platform) as device,
        ):
            device.configure(Settings(chirp, NUM_WORDS))
            device.ping(active=True)
            device.ping(active=False)
            return its, bytes(tap.sent)


def test_our_driver_sends_what_it_sends_but_for_what_we_mean_to_do_otherwise(both_said, platform):
    its, ours = map(commands, both_said)
    # 1. Both step the amplifier up: it once a process, before the first active ping, we with the
    # settings.
    assert [line for line in its if line.startswith(b"!K")] in ([b"!K,1,0,0\n"], [])
    assert [line for line in ours if line.startswith(b"!K")] == [b"!K,1,0,0\n"]
    its, ours = ([line for line in said if not line.startswith(b"!K")] for said in (its, ours))
    # 2. We ask for the version again when opening is over and before the first ping, to know that
    # nothing of before is still on its way.
    assert ours.count(VERSION) > its.count(VERSION) == 1
    assert [line for line in ours if line != VERSION] == [line for line in its if line != VERSION]
    assert ours[0] == its[0] == VERSION
    assert [line for line in its if line.startswith(b"!A")] == {
        "linux": [b"!A,1,0,0\n", b"!A,0,0,0\n"],
        "windows": [b"!A,0,0,0", b"!A,1,0,0"],
    }[platform]


def test_our_chirp_is_its_chirp_but_for_half_a_sample_in_the_ramps(both_said):
    # 3. So much our own incumbent's chirp is apart from it.
    its, ours = codes(both_said[0]), INCUMBENT_CHIRP.dac_codes().astype(int)
    apart = np.abs(its - ours)
    assert len(its) == INCUMBENT_CHIRP.num_dac_samples
    assert apart[RAMP_SAMPLES:-RAMP_SAMPLES].max() == 0
    assert 0 < apart.max() <= RAMP_CODES
    assert np.corrcoef(its, ours)[0, 1] > 0.99999


def test_our_encoder_says_single_commands_as_it_does(client, emulator, platform):
    calls = {
        ("set_counter", 77): ("B", 77),
        ("set_behaviour", True): ("H", 1),
        ("set_behaviour", False): ("H", 0),
        ("toggle_amplifier", False): ("K", 0),
        ("toggle_amplifier", True): ("K", 1),
        ("toggle_external_triggers", True, 2): ("J", 1, 2),
        ("toggle_external_triggers", False, 1): ("J", 0, 1),
    }
    with Wiretap(emulator.path) as tap:
        client.call("open_connection", tap.path)
        client.call("set_behaviour", True)  # which may bring the amplifier with it, once
        for call, ours in calls.items():
            tap.sent.clear()
            client.call(*call)
            expected = protocol.encode_command(*ours)
            if (ours[0], platform) == ("J", "windows"):  # ours is the Linux form, with five fields
                expected = expected.replace(b",0,0\n", b",0\n")
            assert bytes(tap.sent) == expected
        client.call("close_connection")
