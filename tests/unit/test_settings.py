import pytest

from ertis_driver.device import ExternalTrigger, Settings
from ertis_driver.errors import DeviceUnsupported, NotConfigured, SettingsError
from ertis_simulator.device import open_sim


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_words": 0}, "num_words 0, expected a multiple of 32768 up to 16777216"),
        ({"num_words": 16_777_216 + 32_768}, "num_words .* up to 16777216"),
        ({"num_words": 163_841}, "multiple of 32768"),
        ({"num_words": 163_840.0}, r"num_words 163840\.0, expected a multiple"),
        ({"pdm_rate_hz": 2_000_000}, "PDM clock 2000000 Hz, expected 4500000 .* or 1125000"),
        ({"emissions": 0}, "emissions 0, expected a whole number from 1 to 65535"),
        ({"first_ping_index": -1}, "first_ping_index -1, expected .* from 0 to 4294967295"),
        ({"first_ping_index": 2**32}, "first_ping_index 4294967296"),
    ],
)
def test_what_the_device_would_not_accept_is_refused_with_its_range(changes, message):
    with pytest.raises(SettingsError, match=message):
        Settings(**changes)


@pytest.mark.parametrize("pin", [0, 3])
def test_there_are_two_trigger_pins(pin):
    with pytest.raises(SettingsError, match=f"pin {pin}, expected 1 or 2"):
        ExternalTrigger(pin)


def test_the_audible_clock_listens_four_times_as_long():
    assert Settings().listening_s == pytest.approx(36.4e-3, abs=1e-4)
    assert Settings(pdm_rate_hz=1_125_000).listening_s == 4 * Settings().listening_s


@pytest.mark.parametrize(
    "changes",
    [{"external_trigger": ExternalTrigger()}, {"pdm_rate_hz": 1_125_000}, {"emissions": 2}],
)
def test_a_scene_says_what_it_does_not_simulate(changes):
    with open_sim("simulator/ertis_simulator/scenes/demo.yaml") as sonar:
        with pytest.raises(DeviceUnsupported, match=next(iter(changes))):
            sonar.configure(Settings(**changes))
        with pytest.raises(NotConfigured):
            sonar.wait_frame(0.1)
