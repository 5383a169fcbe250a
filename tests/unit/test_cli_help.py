"""Help, versions, near misses and completion: what the command says about itself."""

import re
import shutil
import subprocess

import pytest

from ertis_daemon.cli import COMMANDS, main
from ertis_daemon.cli.completion import _levels
from ertis_daemon.cli.examples import EXAMPLES
from ertis_daemon.cli.parser import build_parser, parts_of

PARTS = [
    f"{name} {part}"
    for name, parser in parts_of(build_parser(COMMANDS, None, every=True)).items()
    for part in parts_of(parser)
]


def told(argv, capsys, code):
    with pytest.raises(SystemExit) as end:
        main(argv)
    assert end.value.code == code
    captured = capsys.readouterr()
    return captured.out if code == 0 else captured.err


@pytest.mark.parametrize("name", [*COMMANDS, *PARTS])
def test_the_help_of_each_command_has_an_example(name, capsys):
    text = told([*name.split(), "--help"], capsys, 0)
    example = re.search("(?i)\nexamples?:\n((  .*\n)+)", text)
    assert f"ertis {name}" in example[1]


@pytest.mark.parametrize("name", EXAMPLES)
def test_each_example_is_understood(name):
    words = EXAMPLES[name].split()
    assert words[:2] == ["ertis", name]
    args = build_parser(COMMANDS, name).parse_args(words[1:])
    assert args.command == name


def test_the_top_help_tells_exit_codes_and_the_version_is_one_line(capsys):
    text = told(["--help"], capsys, 0)
    for said in (
        "0 ok, 1 failed, 2 wrong usage, 3 done with losses or findings",
        "130",
        "example:",
    ):
        assert said in text
    assert told(["--version"], capsys, 0).startswith("ertis ")


@pytest.mark.parametrize(
    ("argv", "meant"),
    [
        (["monitr"], "did you mean 'monitor'?"),
        (["dataset", "chek", "x"], "did you mean 'check'?"),
        (["devices", "--al"], ""),  # an abbreviation, not a mistake
        (["devices", "--jason"], "did you mean '--json'?"),
        (["dataset", "check", "x", "--no-adio=1"], "did you mean '--no-audio'?"),
    ],
)
def test_a_near_miss_names_what_was_meant(argv, meant, capsys):
    if meant:
        assert meant in told(argv, capsys, 2)
    else:
        assert build_parser(COMMANDS, argv[0]).parse_args(argv).all


def test_a_word_that_is_near_nothing_gets_no_suggestion(capsys):
    assert "did you mean" not in told(["zzzzqqq"], capsys, 2)


def script(shell, capsys):
    assert main(["completion", shell]) == 0
    return capsys.readouterr().out


def test_completion_knows_every_command_and_flag(capsys):
    text = script("bash", capsys)
    paths = {level.path for level in _levels("", build_parser(COMMANDS, None, every=True))}
    assert paths >= {"", *COMMANDS, *PARTS}
    for word in ("--no-audio", "--radius", "--trigger-form", "relabel"):
        assert word in text


@pytest.mark.parametrize(
    ("line", "has", "lacks"),
    [
        ("ertis da", {"dataset"}, {"demo", "--json"}),
        ("ertis dataset ch", {"check"}, {"record"}),
        ("ertis dataset check --no", {"--no-audio"}, {"--json"}),
        ("ertis emulate --trigger-form w", {"windows"}, {"--replay"}),
        ("ertis completion f", {"fish"}, {"bash"}),
        ("ertis --v", {"--version"}, {"--help"}),
        ("ertis dataset record --address x --js", {"--json"}, {"--radius"}),
    ],
)
@pytest.mark.parametrize("shell", ["bash", "fish", "zsh"])
def test_a_shell_completes_words(shell, line, has, lacks, capsys, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    found = {"bash": in_bash, "fish": in_fish, "zsh": in_zsh}[shell](
        script(shell, capsys), line, tmp_path
    )
    assert has <= found, found
    assert not lacks & found


def in_bash(text, line, folder):
    words = line.split(" ")
    asked = " ".join(f"'{word}'" for word in words)
    code = f"{text}\nCOMP_WORDS=({asked}); COMP_CWORD={len(words) - 1}; _ertis\n"
    code += 'printf "%s\\n" "${COMPREPLY[@]}"'
    return run(["bash", "--norc", "-c", code], folder)


def in_fish(text, line, folder):
    path = folder / "ertis.fish"
    path.write_text(text)
    found = run(["fish", "--no-config", "-c", f"source {path}; complete -C '{line}'"], folder)
    return {one.partition("\t")[0] for one in found}


def in_zsh(text, line, folder):
    """Without its line editor: what would be offered is caught where it is handed over."""
    words = " ".join(f"'{word}'" for word in line.split(" "))
    code = (
        "compdef() { : }; _files() { : }\n"
        f'compadd() {{ [[ $1 == -a ]] && print -l -- "${{(@P)2}}" || print -l -- "${{@:2}}" }}\n'
        f"{text}\nwords=({words}); CURRENT=${{#words}}; _ertis"
    )
    asked = line.rpartition(" ")[2]
    # Zsh itself leaves out what does not begin as asked.
    return {word for word in run(["zsh", "-f", "-c", code], folder) if word.startswith(asked)}


def run(command, folder):
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        cwd=folder,
        env={"HOME": str(folder), "PATH": "/usr/bin:/bin", "TERM": "dumb"},
    )
    assert done.stderr == ""
    return set(done.stdout.split("\n")) - {""}
