"""Ends commands at random moments, and checks what is left: files, exit codes and processes."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random

from fuzzing.engine import Outcome
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.systems.evaluation.log import read_log
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.recording.recording import Recording

GONE_S = 5.0
"""Time in s after which no process of the command may remain."""

_PROGRAM = [sys.executable, "-m", "sonoservo.diagrams.app"]
_SHORT = ["--set", "duration={duration}", "--out", "{folder}/out"]
_COMMANDS = {
    "run": ["run", "chatelain2013_fig5", "--no-meshcat", *_SHORT],
    "record": [
        "run", "chatelain2013_fig5", "--no-meshcat", "--record", "{folder}/a.seq.nrrd", *_SHORT
    ],
    "track": ["track", "{folder}/in/a.seq.nrrd", "--real-time", "--out", "{folder}/out"],
    "drive": ["drive", *_SHORT],
    "dataset": [
        "dataset", "chatelain2013_fig5", "--count", "{count}", "--volumes", "2", "--jobs", "2",
        "--out", "{folder}/out",
    ],
    "reproduce": ["reproduce", "chatelain2013", "--quick", "--jobs", "2", "--out", "{folder}/out"],
}  # fmt: skip
_SIGNALS = [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT]


def kill_case(number: int, folder: Path, seed: int = 0) -> Outcome:
    """Start a command, end it at a random moment, and judge what is left."""
    rng = Random(f"kills {seed} {number}")
    name = sorted(_COMMANDS)[number % len(_COMMANDS)]
    ending = _SIGNALS[(number // len(_COMMANDS)) % len(_SIGNALS)]
    moment = rng.uniform(0.2, 25)
    what = f"{name}, {ending.name} after {moment:.1f} s"
    if name == "track":
        record = [each.replace("{folder}/a", "{folder}/in/a") for each in _COMMANDS["record"]]
        subprocess.run(_command(record, folder, duration=6), check=True, capture_output=True)
    process = subprocess.Popen(
        _command(_COMMANDS[name], folder, duration=600, count=200),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=_heed_all,  # a background job, or nohup, makes it ignore some
    )
    try:
        output, _ = process.communicate(timeout=moment)
        ended_by_itself = True
    except subprocess.TimeoutExpired:
        ended_by_itself = False
        # A terminal sends Ctrl-C to all processes, a service manager SIGTERM to the first one.
        (os.killpg if ending == signal.SIGINT else os.kill)(process.pid, ending)
        deadline = time.monotonic() + GONE_S
        while (left := _session(process.pid)) and time.monotonic() < deadline:
            time.sleep(0.05)
        if left:
            os.killpg(process.pid, signal.SIGKILL)
            return Outcome(what, "remains", f"processes {left} remain after {GONE_S:g} s")
        output, _ = process.communicate()
    text = output.decode(errors="replace")
    if "Traceback" in text:
        return Outcome(what, "bug", text[-2000:])
    wanted = {0} if ended_by_itself else {-ending, 128 + ending, 0}
    if process.returncode not in wanted:
        return Outcome(what, "bug", f"exit code {process.returncode}: {text[-600:]}")
    try:
        read = _read_all(folder)
    except Exception as error:
        return Outcome(what, "unreadable", repr(error))
    began, told = "scenario.yaml" in read, "summary.json" in read
    if began and not told and ending != signal.SIGKILL:
        return Outcome(what, "no summary", f"readable: {read}; {text[-300:]}")
    return Outcome(what, "good", f"readable: {read}")


def _heed_all() -> None:
    for each in _SIGNALS[1:]:
        handler = signal.default_int_handler if each == signal.SIGINT else signal.SIG_DFL
        signal.signal(each, handler)


def _command(arguments: list[str], folder: Path, **values: float) -> list[str]:
    return [*_PROGRAM, *(each.format(folder=folder, **values) for each in arguments)]


def _session(leader: int) -> list[int]:
    """Return the processes of a session that have not ended."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, *fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == leader and state not in "ZX":
            found.append(int(path.parent.name))
    return found


def _read_all(folder: Path) -> list[str]:
    """Read every result that is there; hidden partial files do not count as results."""
    read = []
    for path in sorted(folder.rglob("*")):
        name = path.name
        if name.startswith(".") or path.is_dir() or "in" in path.parts[-2:-1]:
            continue
        if name == "scenario.yaml":
            load_scenario(path)
        elif name == "log.npz":
            read_log(path, RunLog)
        elif name.endswith((".seq.nrrd", ".partial.seq.nhdr")) and "sweeps" not in name:
            recording = Recording(path)
            assert len(recording)
            assert recording[len(recording) - 1]
        elif name.endswith(".json"):
            json.loads(path.read_text())
        else:
            continue
        read.append(name)
    return read
