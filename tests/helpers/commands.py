"""The command line as a person runs it."""

import io
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

from sonoservo.diagrams.app.cli import run_arguments


def sonoservo(*arguments):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "sonoservo.diagrams.app", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def sonoservo_here(*arguments):
    """Run the command in this process, which saves the seconds that a new one takes to import."""
    out, error = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(error):
        code = run_arguments(arguments)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), error.getvalue())
