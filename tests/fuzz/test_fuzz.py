"""A short run of each fuzz target, and proof that the fuzzer sees what it runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip(
    "atheris", reason="atheris has wheels for CPython 3.10 to 3.14 on Linux x86_64 only"
)
FOUND = 77  # libFuzzer's exit code for a failing input


def fuzz(target, folder, *options):
    """Run a target; return exit code and report."""
    command = [sys.executable, str(Path(__file__).with_name("fuzz.py")), target, str(folder)]
    done = subprocess.run([*command, "-seed=1", *options], capture_output=True, timeout=300)
    return done.returncode, (done.stdout + done.stderr).decode(errors="replace")


def test_coverage_leads_the_fuzzer_to_a_planted_branch(tmp_path):
    # Luck alone would need 2**32 runs.
    code, report = fuzz("planted", tmp_path, "-runs=4000000")
    assert code == FOUND, report
    (failing,) = tmp_path.glob("planted-crash-*")
    assert failing.read_bytes().startswith(b"ERTI")


# Branches covered: a few less than a short run was seen to reach, and none if nothing were
# instrumented.
@pytest.mark.parametrize(
    ("target", "runs", "coverage"),
    [
        ("parser", 4_000, 20),
        ("firmware", 4_000, 50),
        ("frame", 20_000, 8),
        ("mcap", 3_000, 165),
        ("raw", 1_000, 15),
    ],
)
def test_nothing_is_found_in_a_short_run(tmp_path, target, runs, coverage):
    code, report = fuzz(target, tmp_path, f"-runs={runs}")
    assert code == 0, report
    reached = max(int(count) for count in re.findall(r"\bcov: (\d+)", report))
    assert reached >= coverage, report
