"""The fuzzers on a few cases; `make fuzz` runs many."""

import os
import re
import subprocess
import sys

import pytest


def fuzz(*counts):
    """Run the fuzzers in a process of their own, as forks of one with threads are not safe."""
    return python("-m", "fuzzing", "--seed", "1", *counts)


def python(*arguments):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600)


def test_no_damage_breaks_the_program():
    counts = {"files": 40, "scenarios": 6, "commands": 2, "runs": 0, "kills": 0}
    result = fuzz(*(f"--{name}={count}" for name, count in counts.items()))
    assert result.returncode == 0, result.stdout + result.stderr
    for name, count in counts.items():
        assert count == 0 or re.search(rf"^{name}: {count} ", result.stdout, re.MULTILINE), name


@pytest.mark.slow
def test_an_end_at_any_moment_leaves_readable_files_and_no_process():
    counts = ["--files=0", "--scenarios=0", "--commands=0", "--runs=0", "--kills=24"]
    result = fuzz(*counts)
    assert result.returncode == 0, result.stdout + result.stderr
