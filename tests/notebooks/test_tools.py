"""Help of the tools beside the notebooks."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"


def called(name, *arguments):
    command = [sys.executable, str(FOLDER / name), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", ["execute", "moving_picture"])
def test_help_is_given_and_nothing_is_done(name):
    done = called(f"{name}.py", "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {name}.py")


def test_an_unknown_notebook_is_refused_in_a_line():
    done = called("execute.py", "9_nothing.py")
    assert done.returncode == 2
    assert "there is no notebook 9_nothing.py" in done.stderr
    assert "Traceback" not in done.stderr
