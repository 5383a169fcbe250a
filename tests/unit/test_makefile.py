"""``make setup`` in a folder that was renamed or copied with its virtual environment."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def folder(tmp_path):
    place = tmp_path / "a robot"
    (place / ".venv").mkdir(parents=True)
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy2(ROOT / name, place)
    return place


def planned(folder):
    """What setup would do."""
    done = subprocess.run(
        ["make", "--dry-run", "setup"], cwd=folder, capture_output=True, text=True, check=True
    )
    return done.stdout


def installed_for(folder, path):
    stamp = folder / ".venv" / ".installed"
    stamp.write_text(f"{path}\n")
    newer = (folder / "pyproject.toml").stat().st_mtime + 10
    os.utime(stamp, (newer, newer))


def test_what_is_set_up_is_left_alone(folder):
    installed_for(folder, folder)
    assert "pip install" not in planned(folder)


def test_what_was_set_up_under_another_name_is_made_anew(folder):
    installed_for(folder, folder.with_name("old name"))
    plan = planned(folder)
    assert "|| rm -rf .venv" in plan
    assert plan.index("rm -rf .venv") < plan.index("-m venv .venv") < plan.index("pip install")
