"""``ertis doctor``: each look tells what is and what to do."""

import json
import shutil
import socket
from pathlib import Path

import pytest
import zenoh

from ertis_daemon import checkup
from ertis_daemon.cli import main
from ertis_daemon.config import ChirpConfig, Config, ZenohConfig
from ertis_daemon.zenoh_session import close_session, open_session, session_config
from ertis_driver.discover import Holder, PluggedIn

SONAR = PluggedIn(
    port="/dev/ttyACM0",
    usb_node="/dev/bus/usb/001/002",
    vendor_id=0x0483,
    product_id=0x5740,
    product="eRTIS v3",
    may_open=True,
)


def test_the_doctor_tells_it_all_and_changes_nothing(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code = main(["doctor", "--json"])
    told = json.loads(capsys.readouterr().out)
    states = {check["name"]: check["state"] for check in told["checks"]}
    assert code == (0 if told["healthy"] else 3)
    assert {"python", "blas", "extra sim", "sonar", "udev rule", "model", "zenoh", "disk"} <= set(
        states
    )
    assert states["python"] == states["model"] == states["extra plot"] == "ok"
    for check in told["checks"]:
        assert bool(check["todo"]) == (check["state"] != "ok") or check["name"] == "clock"
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_setting_is_marked_with_what_to_do(capsys, tmp_path):
    path = tmp_path / "e.yaml"
    path.write_text("chirp: {f_start_hz: 70000}\n")
    assert main(["doctor", "--config", str(path)]) == 3
    out = capsys.readouterr().out
    assert "!!  model         " in out
    assert "-> name another model or chirp" in out


@pytest.mark.parametrize(
    ("devices", "state", "said"),
    [
        ([], "missing", "none is plugged in"),
        ([SONAR], "ok", "/dev/ttyACM0 0483:5740 eRTIS v3 (no serial number): free"),
        ([PluggedIn(port="/dev/ttyS0", may_open=True)], "missing", "none is plugged in"),
    ],
)
def test_sonars_are_found_among_ports(devices, state, said):
    (check,) = checkup.check_sonars(devices)
    assert (check.state, check.said) == (state, said)


def test_a_sonar_that_may_not_be_opened_or_is_held_says_what_to_do():
    from dataclasses import replace

    (closed,) = checkup.check_sonars([replace(SONAR, may_open=False)])
    assert closed.state == "wrong"
    assert "sudo make udev" in closed.todo
    (held,) = checkup.check_sonars([replace(SONAR, holders=(Holder(42, "minicom"),))])
    assert held.state == "missing"
    assert held.said.endswith("held by 42 (minicom)")


def test_the_udev_rule_is_found_by_its_name(tmp_path):
    assert checkup.check_rule((tmp_path,)).state == "missing"
    shutil.copy(Path("udev") / checkup.RULE_NAME, tmp_path)
    assert checkup.check_rule((tmp_path / "no", tmp_path)).state == "ok"


def test_modem_manager_is_found_among_processes(tmp_path):
    for pid, name in ((1, "init"), (77, "ModemManager")):
        (tmp_path / str(pid)).mkdir()
        (tmp_path / str(pid) / "comm").write_text(f"{name}\n")
    check = checkup.check_modem_manager(tmp_path)
    assert (check.state, check.said) == ("missing", "running, process 77")
    (tmp_path / "77/comm").unlink()
    assert checkup.check_modem_manager(tmp_path).state == "ok"


def test_a_model_that_does_not_fit_the_settings_is_wrong():
    assert checkup.check_model(Config()).state == "ok"
    check = checkup.check_model(Config(chirp=ChirpConfig(f_start_hz=70_000.0)))
    assert check.state == "wrong"
    assert "70000" in check.said


def test_a_zenoh_router_is_there_or_not():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        place = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    config = Config(zenoh=ZenohConfig(connect=(place,)))
    check = checkup.check_zenoh(config)
    assert check.state == "missing"
    assert f"no router at {place}" in check.said
    zenoh.init_log_from_env_or("off")
    router = open_session(session_config("router", (), (place,)))
    try:
        check = checkup.check_zenoh(config)
    finally:
        close_session(router)
    assert check.state == "ok", check


def test_disk_and_clock_are_told(tmp_path):
    check = checkup.check_disk(tmp_path)
    assert "h of recording" in check.said
    assert checkup.check_clock().state in ("ok", "missing")
