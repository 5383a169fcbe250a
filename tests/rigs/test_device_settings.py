"""Settings and chirps, as the emulated firmware receives them over a pty."""

import dataclasses

import numpy as np
import pytest

from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.errors import DeviceUnsupported, NotConfigured, UploadFailed
from ertis_driver.ertis_device import open_serial
from ertis_driver.firmware import FirmwareState

SHORT = Settings(num_words=32_768)


class Memory(FirmwareState):
    """Counts the DAC samples that it is sent."""

    samples_sent = 0

    def _set(self, letter, args):
        if letter == "C":
            self.samples_sent += 1
        return super()._set(letter, args)


@pytest.fixture
def memory(source):
    return Memory(source)


def reversed_chirp(chirp):
    return CustomChirp(tuple(chirp.dac_codes()[::-1].tolist()), chirp.dac_rate_hz)


def test_each_setting_reaches_the_firmware(emulator, source):
    settings = Settings(
        INCUMBENT_CHIRP,
        num_words=65_536,
        pdm_rate_hz=1_125_000,
        emissions=3,
        first_ping_index=1000,
        amplifier=True,
    )
    with open_serial(emulator.path) as device:
        device.configure(settings)
        frame = device.ping()
        request = source.requests[-1]
        assert (frame.ping_index, frame.pdm_rate_hz) == (1000, 1_125_000)
        assert (request.num_words, request.pdm_rate_hz) == (65_536, 1_125_000)
        assert (request.emissions, request.amplified) == (3, True)
        np.testing.assert_array_equal(request.dac_codes, INCUMBENT_CHIRP.dac_codes())
        device.configure(SHORT)
        assert device.ping().ping_index == 1001, "the counter goes on"
        request = source.requests[-1]
        assert (request.pdm_rate_hz, request.emissions, request.amplified) == (4_500_000, 1, True)
        device.configure(dataclasses.replace(SHORT, amplifier=False))
        device.ping()
        assert not source.requests[-1].amplified


@pytest.mark.parametrize(
    ("letter", "change", "message"),
    [
        ("K", {"amplifier": True}, "no amplifier step-up .K.: configure it with amplifier=None"),
        ("J", {"external_trigger": ExternalTrigger(2)}, "no external trigger .J.: configure it"),
    ],
)
def test_what_the_firmware_lacks_is_said_and_can_be_done_without(
    faulty, source, letter, change, message
):
    state = FirmwareState(source, unsupported=letter)
    with open_serial(faulty(lambda reply: reply, state)) as device:
        with pytest.raises(DeviceUnsupported, match=message):
            device.configure(dataclasses.replace(SHORT, **change))
        with pytest.raises(NotConfigured):
            device.ping()
        device.configure(SHORT)
        assert device.ping().ping_index == 0


def test_firmware_that_never_heard_of_j_and_k_is_asked_once_for_k_and_pings(faulty, source):
    seen = []

    class Old(FirmwareState):
        def _take(self, line):
            seen.append(line[1:2].decode())
            return None if line[1:2] in (b"J", b"K") else super()._take(line)

    with open_serial(faulty(lambda reply: reply, Old(source)), timeout_s=0.3) as device:
        device.configure(SHORT)
        device.configure(SHORT)
        assert device.ping().ping_index == 0
    order = [letter for letter in seen if letter not in ("C", "")]
    told = ["G", "F", "D", "E", "L"]
    assert order == ["Y", "Y", *told, "L", "I", "K", "Y", "Y", *told, "I", "Y"]


def test_a_chirp_is_sent_again_only_if_it_is_another(faulty, memory, source):
    with open_serial(faulty(lambda reply: reply, memory)) as device:
        device.configure(SHORT)
        assert memory.samples_sent == 1126
        device.configure(dataclasses.replace(SHORT, num_words=65_536))
        assert memory.samples_sent == 1126
        device.configure(Settings(INCUMBENT_CHIRP, 32_768))
        assert memory.samples_sent == 2 * 1126


def test_a_reversed_chirp_of_the_same_hash_is_sent(faulty, memory, source):
    backward = reversed_chirp(DEFAULT_CHIRP)
    with open_serial(faulty(lambda reply: reply, memory)) as device:
        for chirp in (DEFAULT_CHIRP, backward, DEFAULT_CHIRP):
            device.configure(Settings(chirp, 32_768))
            device.ping()
            np.testing.assert_array_equal(source.requests[-1].dac_codes, chirp.dac_codes())
    assert memory.samples_sent == 3 * 1126


def test_another_session_sends_it_again_whatever_the_hash_says(faulty, memory):
    path = faulty(lambda reply: reply, memory)
    for count in (1, 2):
        with open_serial(path) as device:
            device.configure(SHORT)
            assert memory.samples_sent == count * 1126


def test_a_memory_whose_hash_has_changed_is_filled_again(faulty, memory, source):
    with open_serial(faulty(lambda reply: reply, memory)) as device:
        device.configure(SHORT)
        memory._dac_codes[7] ^= 1
        device.configure(SHORT)
        device.ping()
    np.testing.assert_array_equal(source.requests[-1].dac_codes, DEFAULT_CHIRP.dac_codes())


def test_a_chirp_with_the_hash_of_an_idle_memory_is_always_sent(faulty, memory):
    chirp = CustomChirp((5, 4090) * 50)  # XOR 0, as 100 times 2048
    with open_serial(faulty(lambda reply: reply, memory)) as device:
        device.configure(Settings(chirp, 32_768))
        device.configure(Settings(chirp, 32_768))
    assert memory.samples_sent == 200


def test_after_a_failed_upload_there_are_no_settings_and_the_next_one_is_whole(faulty, source):
    class Forgetful(Memory):
        deaf = True

        def _set(self, letter, args):
            if letter == "C" and args[0] == 500 and self.deaf:
                return args[1]
            return super()._set(letter, args)

    state = Forgetful(source)
    with open_serial(faulty(lambda reply: reply, state)) as device:
        with pytest.raises(UploadFailed, match="another chirp than was sent"):
            device.configure(SHORT)
        assert device.settings is None
        with pytest.raises(NotConfigured):
            device.ping()
        state.deaf = False
        device.configure(SHORT)
        device.ping()
    np.testing.assert_array_equal(source.requests[-1].dac_codes, DEFAULT_CHIRP.dac_codes())


def test_an_upload_tells_how_far_it_is(emulator):
    told = []
    with open_serial(
        emulator.path, progress=lambda sent, total: told.append((sent, total))
    ) as device:
        device.configure(SHORT)
    assert told == sorted(told)
    assert {total for _, total in told} == {1126}
    assert told[-1] == (1126, 1126)
    assert len(told) > 10


def test_two_sonars_in_one_process_do_not_know_of_each_other(emulator_pair):
    (path_a, source_a), (path_b, source_b) = emulator_pair
    with open_serial(path_a) as a, open_serial(path_b, trigger_form="windows") as b:
        a.configure(SHORT)
        b.configure(Settings(INCUMBENT_CHIRP, 65_536, first_ping_index=70))
        for count in range(3):
            assert (a.ping().ping_index, b.ping(active=False).ping_index) == (count, 70 + count)
        assert (a.settings, b.settings.num_words) == (SHORT, 65_536)
    np.testing.assert_array_equal(source_a.requests[-1].dac_codes, DEFAULT_CHIRP.dac_codes())
    np.testing.assert_array_equal(source_b.requests[-1].dac_codes, INCUMBENT_CHIRP.dac_codes())
    assert [request.active for request in source_b.requests] == [False] * 3
