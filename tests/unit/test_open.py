import pytest

from ertis_driver import open as opener
from ertis_driver.errors import AddressError, DeviceNotFound, RecordingError
from ertis_driver.open import is_hardware, open_device
from ertis_driver.replay_device import ReplayDevice


@pytest.mark.parametrize("address", ["", "serial", "serial:", ":", "/dev/ttyACM0", "garage.mcap"])
def test_a_malformed_address_shows_a_good_one(address):
    with pytest.raises(AddressError, match="expected") as caught:
        open_device(address)
    assert "serial:/dev/ttyACM0" in str(caught.value)


def test_an_unknown_kind_names_the_known_ones():
    with pytest.raises(AddressError, match="serial, usb, replay, sim"):
        open_device("bluetooth:12")


def test_a_kind_that_is_not_installed_says_so(monkeypatch):
    monkeypatch.setitem(opener.KINDS, "sim", "ertis_no_such_module:open_sim")
    with pytest.raises(AddressError, match="'sim' is not usable here"):
        open_device("sim:hall.yaml")


def test_a_replay_opens_with_its_options(tmp_path):
    path = tmp_path / "a:b.bin"  # only the first colon divides
    path.write_bytes(bytes(4 * 32_768))
    with open_device(f"replay:{path}", rate=1.0) as device:
        assert isinstance(device, ReplayDevice)
        assert device.info.address == f"replay:{path}"
        assert device.info.source == "replay"


def test_errors_of_the_device_come_through(tmp_path):
    with pytest.raises(RecordingError, match="no recording"):
        open_device(f"replay:{tmp_path / 'none.mcap'}")
    with pytest.raises(DeviceNotFound):
        open_device(f"serial:{tmp_path / 'none'}")


@pytest.mark.parametrize(
    ("address", "expected"),
    [("serial:sn=1", True), ("usb:0483:5740", True), ("replay:serial:x", False), ("sim:x", False)],
)
def test_hardware_is_what_can_be_unplugged(address, expected):
    assert is_hardware(address) is expected
