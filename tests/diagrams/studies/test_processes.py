import os
import signal
import subprocess
import sys

import pytest

from sonoservo.diagrams.studies.processes import keeping_ctrl_c


def interrupt_both():
    """Send Ctrl-C to a new process and to this one, and return the new one at its end."""
    with keeping_ctrl_c():
        process = subprocess.Popen(
            [sys.executable, "-c", "import time; print(1, flush=True); time.sleep(0.2); print(2)"],
            stdout=subprocess.PIPE,
        )
        assert process.stdout.readline() == b"1\n"
        for each in (process.pid, os.getpid()):
            os.kill(each, signal.SIGINT)
        assert process.communicate() == (b"2\n", None)
        assert process.returncode == 0


def test_ctrl_c_does_not_reach_processes_and_reaches_this_one_later():
    # A process that a shell puts in the background ignores it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            interrupt_both()
    finally:
        signal.signal(signal.SIGINT, before)
