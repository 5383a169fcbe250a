"""Rigs D and E: the installed daemon under systemd and udev, in a QEMU guest with a USB gadget.

What ``make install`` stages here is laid over the guest's root; see qemu/README.md.
"""

import re
import subprocess

import pytest
from qemu.kernel import CHECKOUT
from qemu.rig import PYTHON, boot_or_skip, found, run_from_index, skip_without_systemd

pytestmark = [pytest.mark.slow, pytest.mark.index]

INSTALL_S = 400
GUEST_S = 1300
# An emulated machine is thirty times slower than a robot's, and so is looking at it: why a unit
# ended can be asked only until it is started again.
PATIENCE = """[Service]
TimeoutStartSec=400s
WatchdogSec=60s
TimeoutStopSec=60s
RestartSec=10s
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """A clean tree after ``make install``."""
    skip_without_systemd()
    stage = tmp_path_factory.mktemp("stage")
    run_from_index(
        ["make", "-s", "install", f"DESTDIR={stage}", f"PYTHON={PYTHON}"],
        cwd=CHECKOUT,
        limit_s=INSTALL_S,
        unless="No matching distribution|Could not find a version|python3-venv",
    )
    return stage


@pytest.fixture(scope="module")
def guest(installed):
    """One boot for all tests."""
    drop_in = installed / "etc/systemd/system/ertis-daemon@.service.d/emulated.conf"
    drop_in.parent.mkdir()
    drop_in.write_text(PATIENCE)
    example = (installed / "etc/ertis/ertis.yaml").read_text()
    short, count = re.subn(r"(?m)^num_words: .*$", "num_words: 65536", example)
    assert count == 1
    (installed / "etc/ertis/ERTIS001.yaml").write_text(short)
    return boot_or_skip(
        ["-m", "qemu.inside.job", "without_a_configuration", "service_life"],
        "systemd.txt",
        stage=installed,
        timeout_s=GUEST_S,
    )


@pytest.fixture
def life(guest, capsys):
    result = found(guest, "service_life")
    with capsys.disabled():
        for key in ("plugged", "process", "hung", "after_hang", "unplugged", "replugged"):
            print(f"\n{key}: {result[key]}", end="")
        print()
    return result


def test_make_install_leaves_program_units_rule_and_configuration(installed):
    command = (installed / "opt/ertis/bin/ertis").read_text().splitlines()[0]
    assert command == "#!/opt/ertis/bin/python"
    assert str((installed / "usr/local/bin/ertis").readlink()) == "/opt/ertis/bin/ertis"
    for name in ("ertis-daemon.service", "ertis-daemon@.service"):
        assert (installed / "etc/systemd/system" / name).exists()
    assert (installed / "etc/udev/rules.d/70-ertis.rules").exists()
    example = installed / "opt/ertis/share/ertis/ertis.yaml"
    assert (installed / "etc/ertis/ertis.yaml").read_text() == example.read_text()
    staged = [
        str(path)
        for path in (installed / "opt/ertis/bin").iterdir()
        if path.is_file() and not path.is_symlink() and str(installed).encode() in path.read_bytes()
    ]
    assert staged == [], "nothing may name the folder it was staged in"


def test_a_plug_starts_the_daemon_which_becomes_ready_and_works(life):
    assert life["before"] == "inactive"
    assert life["plugged"]["state"] == "active"  # Type=notify: active is READY
    assert life["name"].startswith("/dev/ttyACM")
    assert "running" in life["working"]


def test_it_runs_as_nobody_in_particular_with_nothing_but_its_port(life):
    process = life["process"]
    assert 61184 <= process["uid"] <= 65519, "one of systemd's dynamic users"
    assert int(process["capabilities"], 16) == 0
    assert process["seccomp"] == "2"
    exposure = re.search(r": (\d+\.\d) ", life["security"])
    assert float(exposure[1]) <= 1.2


def test_a_daemon_that_hangs_is_ended_by_the_watchdog_and_started_again(life):
    assert life["hung"]["restarts"] == 1
    assert life["hung"]["results"] == ["watchdog"]
    assert life["after_hang"]["state"] == "active"


def test_pulled_out_it_stops_and_plugged_in_again_it_runs(life):
    assert life["unplugged"]["state"] == "inactive"
    assert life["name_gone"]
    assert life["replugged"]["state"] == "active"
    assert "running" in life["working_again"]


def test_told_to_stop_it_ends_cleanly(life):
    assert life["stopped"]["Result"] == "success"
    assert life["stopped"]["ExecMainStatus"] == "0"


def test_a_sonar_without_a_configuration_is_left_alone(guest):
    result = found(guest, "without_a_configuration")
    assert result == {"ActiveState": "inactive", "ConditionResult": "no", "Result": "success"} | {
        "seconds": result["seconds"]
    }


def test_what_was_installed_is_uninstalled(installed, guest):
    for extra in ("ertis-daemon@.service.d/emulated.conf",):
        path = installed / "etc/systemd/system" / extra
        path.unlink()
        path.parent.rmdir()
    (installed / "etc/ertis/ERTIS001.yaml").unlink()
    subprocess.run(["make", "-s", "uninstall", f"DESTDIR={installed}"], cwd=CHECKOUT, check=True)
    assert sorted(installed.rglob("*")) == []
