"""The command line as a person runs it."""

import subprocess
import sys


def sonoservo(*arguments):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", "from sonoservo.diagrams.app.cli import main; main()", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
