"""The systemd units and their installation, on this machine but without touching it."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
SYSTEMD = TOP / "daemon" / "systemd"
UNITS = ("ertis-daemon.service", "ertis-daemon@.service")
EXPOSURE = "1.2"

needs_analyze = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="no systemd-analyze: apt install systemd"
)


def settings(name):
    """By key: its values, in order."""
    found = {}
    for line in (SYSTEMD / name).read_text().splitlines():
        if "=" in line and not line.startswith("#"):
            key, value = line.split("=", 1)
            found.setdefault(key, []).append(value)
    return found


@needs_analyze
@pytest.mark.parametrize("name", UNITS)
def test_the_unit_is_exposed_no_more_than_it_must_be(name, capsys):
    command = ["systemd-analyze", "security", "--no-pager", "--offline=true"]
    limit = EXPOSURE.replace(".", "")
    done = subprocess.run(
        [*command, f"--threshold={limit}", str(SYSTEMD / name)],
        capture_output=True,
        text=True,
        check=False,
    )
    verdict = done.stdout.strip().splitlines()[-1]
    with capsys.disabled():
        print(f"\n{verdict}")
    assert done.returncode == 0, verdict


@needs_analyze
@pytest.mark.parametrize("name", UNITS)
def test_systemd_understands_every_line_of_the_unit(name):
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(SYSTEMD / name)],
        capture_output=True,
        text=True,
        check=False,
    )
    said = [line for line in done.stderr.splitlines() if "ertis" in line]
    assert [line for line in said if "/opt/ertis/bin/ertis is not executable" not in line] == []


def test_both_units_are_hardened_alike():
    plain, template = (settings(name) for name in UNITS)
    differ = {key for key in {*plain, *template} if plain.get(key) != template.get(key)}
    assert differ == {
        *("Description", "After", "BindsTo", "ConditionPathExists", "WantedBy"),
        *("ExecStart", "StateDirectory", "WorkingDirectory"),
    }


def test_what_the_issue_asks_of_a_unit_is_in_it():
    plain = settings(UNITS[0])
    assert plain["Type"] == ["notify"]
    assert plain["MemoryDenyWriteExecute"] == plain["DynamicUser"] == ["yes"]
    assert plain["DevicePolicy"] == ["closed"]
    assert plain["DeviceAllow"] == ["char-166 rw"]
    assert "OPENBLAS_NUM_THREADS=1" in plain["Environment"][0].split()
    assert plain["TimeoutStopSec"] == ["5s"]
    assert "WatchdogSec" in plain


def test_the_rule_asks_for_the_template_and_it_for_a_configuration():
    rule = (TOP / "udev" / "70-ertis.rules").read_text()
    assert 'SYSTEMD_WANTS}+="ertis-daemon@$env{ID_SERIAL_SHORT}.service"' in rule
    assert 'SYMLINK+="ertis-$env{ID_SERIAL_SHORT}"' in rule
    template = settings(UNITS[1])
    assert template["ConditionPathExists"] == ["/etc/ertis/%i.yaml"]
    assert template["BindsTo"] == [r"dev-ertis\x2d%i.device"]
    assert template["ExecStart"][0].endswith("serial:/dev/ertis-%i")


def tree(folder):
    """Everything below: path, and content or where a link points."""
    return {
        str(path.relative_to(folder)): (
            str(path.readlink()) if path.is_symlink() else path.is_file() and path.read_bytes()
        )
        for path in folder.rglob("*")
    }


def make(target, stage, **settings):
    values = [f"{name}={value}" for name, value in {"DESTDIR": stage, **settings}.items()]
    return subprocess.run(
        ["make", "-s", target, *values], cwd=TOP, capture_output=True, text=True, check=False
    )


def pretend_installed(stage):
    """What ``make install`` leaves, without an hour of pip: for tests of what removes it."""
    for name in UNITS:
        put(stage / "etc/systemd/system" / name, (SYSTEMD / name).read_text())
    put(stage / "etc/udev/rules.d/70-ertis.rules", "rule")
    put(stage / "opt/ertis/pyvenv.cfg", "")
    put(stage / "opt/ertis/share/ertis/ertis.yaml", "example")
    put(stage / "etc/ertis/ertis.yaml", "example")
    (stage / "usr/local/bin").mkdir(parents=True)
    (stage / "usr/local/bin/ertis").symlink_to("/opt/ertis/bin/ertis")


def put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def test_uninstall_leaves_nothing(tmp_path):
    pretend_installed(tmp_path)
    done = make("uninstall", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert tree(tmp_path) == {}


def test_uninstall_leaves_what_is_not_its_own_and_a_changed_configuration(tmp_path):
    theirs = {"etc/systemd/system/other.service": "a", "opt/other/x": "b", "etc/ertis/f.yaml": "c"}
    for name, text in theirs.items():
        put(tmp_path / name, text)
    pretend_installed(tmp_path)
    put(tmp_path / "etc/ertis/ertis.yaml", "changed")
    (tmp_path / "usr/local/bin/ertis").unlink()
    (tmp_path / "usr/local/bin/ertis").symlink_to("/home/me/ertis")
    done = make("uninstall", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "kept /etc/ertis/ertis.yaml: you have changed it" in done.stdout
    files = {path for path, what in tree(tmp_path).items() if what is not False}
    assert files == {*theirs, "etc/ertis/ertis.yaml", "usr/local/bin/ertis"}


def test_uninstall_where_nothing_is_installed_says_so(tmp_path):
    done = make("uninstall", tmp_path)
    assert done.returncode != 0
    assert "no installation in" in done.stderr


def test_install_refuses_a_python_that_the_service_could_not_see(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho /home/me/python\n")
    python.chmod(0o755)
    done = make("install", tmp_path / "stage", PYTHON=python)
    assert done.returncode != 0
    assert "/home/me/python, which the service cannot see" in done.stderr
    assert not (tmp_path / "stage").exists()


@pytest.mark.skipif(not Path("/usr/bin/python3").exists(), reason="no /usr/bin/python3")
def test_install_refuses_to_write_over_something_else(tmp_path):
    put(tmp_path / "opt/ertis/precious", "x")
    done = make("install", tmp_path, PYTHON="/usr/bin/python3")
    assert done.returncode != 0
    assert re.search("is no installation of ertis|apt install python3-venv", done.stderr)
    assert (tmp_path / "opt/ertis/precious").read_text() == "x"


def test_the_scripts_are_plain_shell():
    for script in (SYSTEMD / "install.sh", TOP / "daemon" / "security" / "make-certificates.sh"):
        assert os.access(script, os.X_OK)
        subprocess.run(["sh", "-n", str(script)], check=True)
