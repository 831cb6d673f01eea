"""Ends from outside: a summary is left, and nothing remains."""

import json
import signal
import subprocess
import sys
import time

import pytest

from sonoservo.diagrams.app.interruption import PATIENCE

_BUSY = """
import sys, time
from sonoservo.diagrams.app import interruption
interruption.PATIENCE = 0.3
interruption.catch_interruptions()
try:
    print("ready", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    if sys.argv[1] == "hang":
        while True:
            pass
    sys.exit(interruption.interrupted_code())
"""

_INTERRUPTED = """
import os, signal, sys, time
from sonoservo.diagrams.app import interruption
interruption.catch_interruptions()
{setting}
try:
    {act}
    time.sleep(1)
    print("slept")
except KeyboardInterrupt:
    sys.exit(interruption.interrupted_code())
"""


def interrupted(setting, act):
    """Run a program in which ``act`` is interrupted."""
    code = _INTERRUPTED.format(setting=setting, act=act)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


_FINALIZED = """
class Finalized:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
"""


def test_an_interruption_that_a_finalizer_swallows_is_raised_again():
    result = interrupted(_FINALIZED, "Finalized()")
    assert (result.returncode, result.stdout, result.stderr) == (128 + signal.SIGTERM, "", "")


_CALLED_BACK = """
callback = '''
def notify():
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.05)
    print("not disturbed", flush=True)
'''
exec(compile(callback, os.path.join("llvmlite", "binding", "executionengine.py"), "exec"))
"""


def test_an_interruption_waits_for_the_compiler_s_callbacks():
    result = interrupted(_CALLED_BACK, "notify()")
    assert (result.returncode, result.stdout) == (128 + signal.SIGTERM, "not disturbed\n")


@pytest.mark.parametrize(
    ("number", "how"), [(signal.SIGINT, "end"), (signal.SIGTERM, "hang"), (signal.SIGHUP, "end")]
)
def test_every_signal_ends_the_program_even_if_it_hangs(number, how):
    process = subprocess.Popen(
        [sys.executable, "-c", _BUSY, how], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout.readline() == b"ready\n"
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert (b"left out" in said) == (how == "hang")


def test_what_nohup_ignores_stays_ignored():
    code = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)" + _BUSY.replace("60", "1")
    process = subprocess.Popen([sys.executable, "-c", code, "end"], stdout=subprocess.PIPE)
    process.stdout.readline()
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=60) == 0


def test_a_run_that_is_ended_leaves_its_summary(tmp_path):
    assert PATIENCE < 10
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "sonoservo.diagrams.app",
         "run", "chatelain2013_fig5", "--no-meshcat", "--set", "duration=600", "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (out / "scenario.yaml").is_file() and time.monotonic() < deadline:
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM, said
    assert "Traceback" not in said
    assert json.loads((out / "summary.json").read_text())["interrupted"] is True
