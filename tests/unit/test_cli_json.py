"""Every command that says something says it as JSON, too, if it is asked to."""

import json

import pytest

from ertis_daemon.cli import COMMANDS, main

# A script for a shell; commands that say nothing else.
WITHOUT = {"completion", "train", "calibrate"}
PARTS = {"dataset": ("record", "check", "relabel", "stats"), "export": ("landmark",)}
CALLS = [
    (name, *part)
    for name in sorted(COMMANDS)
    if name not in WITHOUT
    for part in [(one,) for one in PARTS.get(name, ())] or [()]
]


@pytest.mark.parametrize("words", CALLS, ids=" ".join)
def test_a_command_knows_json(words, capsys):
    with pytest.raises(SystemExit):
        main([*words, "--help"])
    assert "--json" in capsys.readouterr().out


def test_simulate_says_what_it_made(tmp_path, capsys):
    path = tmp_path / "one.mcap"
    assert main(["simulate", "--random", "-n", "1", "-j", "1", "-o", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "recording": str(path),
        "plot": None,
        "pings": 1,
    }


def test_simulate_says_what_of_a_data_set_is_new(tmp_path, capsys):
    folder = tmp_path / "data"
    make = ["simulate", "--dataset", str(folder), "-n", "1", "-j", "1", "--json"]
    assert main(make) == 0
    assert json.loads(capsys.readouterr().out)["made_now"] == 1
    assert main(make) == 0
    said = json.loads(capsys.readouterr().out)
    assert said == {"dataset": str(folder), "pings": 1, "made_now": 0}


def test_validate_says_every_figure(capsys):
    assert main(["validate", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["source"] == "sim"
    assert said["exceeded"] == 0
    assert {"dish", "air", "waves", "modulator"} <= set(said)
    assert all(one["agrees"] for one in said["air"])
