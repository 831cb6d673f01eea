"""Ends commands at random moments, and checks what is left: files, exit codes and processes."""

import atexit
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

from fuzzing.engine import Outcome
from sonoservo.diagrams import load_scenario
from sonoservo.systems.evaluation.log import read_log
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.recording import Recording

GONE_S = 5.0
"""Time in s after which no process of the command may remain."""

AGAIN_S = 6.0
"""CPU time in s after which the same command, started again, is ended with Ctrl-C."""

_PATIENCE = 20
"""Wall-clock time by CPU time after which a command that waits is ended anyway."""

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
    moment = rng.uniform(0.2, 15)
    what = f"{name}, {ending.name} after {moment:.1f} s of CPU"
    if name == "track":
        shutil.copytree(recorded(), folder / "in")
    command = _command(_COMMANDS[name], folder, duration=600, count=200)
    first = _end(command, moment, ending)
    if fault := _fault(first, ending):
        return Outcome(what, *fault)
    try:
        read = _read_all(folder)
    except Exception as error:
        return Outcome(what, "unreadable", repr(error))
    began, told = "scenario.yaml" in read, "summary.json" in read
    if began and not told and ending != signal.SIGKILL:
        return Outcome(what, "no summary", f"readable: {read}; {first.text[-300:]}")
    again = _end(command, AGAIN_S, signal.SIGINT)
    says_how = again.code == 2 and again.text.count("sonoservo: ") == 1
    if not says_how and (fault := _fault(again, signal.SIGINT)):
        return Outcome(f"{what}, and again", *fault)
    try:
        read_again = _read_all(folder)
    except Exception as error:
        return Outcome(what, "unreadable", f"the second time: {error!r}")
    how = f"; again: {again.text.strip()[-300:]}" if says_how else ""
    return Outcome(what, "good", f"readable: {read}, then {read_again}{how}")


@dataclass
class _Ended:
    """How a command ended: exit code, output, and the processes that remained."""

    code: int
    text: str
    left: list[int]
    by_itself: bool


def _end(command: list[str], moment: float, ending: signal.Signals) -> _Ended:
    """Start a command, and end it when it has used a CPU time in s, whatever the machine's load."""
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(  # a background job, or nohup, makes it ignore some signals
            command, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            preexec_fn=_heed_all,
        )  # fmt: skip
        latest = time.monotonic() + _PATIENCE * moment
        while process.poll() is None and time.monotonic() < latest:
            if sum(_session(process.pid).values()) > moment:
                break
            time.sleep(0.05)
        by_itself = process.poll() is not None
        if not by_itself:
            # A terminal sends Ctrl-C to all processes, a service manager SIGTERM to the first one.
            (os.killpg if ending == signal.SIGINT else os.kill)(process.pid, ending)
        deadline = time.monotonic() + GONE_S
        while (left := _session(process.pid)) and time.monotonic() < deadline:
            time.sleep(0.05)
        if left:
            os.killpg(process.pid, signal.SIGKILL)
        code = process.wait()
        output.seek(0)
        text = output.read().decode(errors="replace")
    return _Ended(code, text, sorted(left), by_itself)


def _fault(ended: _Ended, ending: signal.Signals) -> tuple[str, str] | None:
    """Return the result and the detail of a wrong end, if it is one."""
    if ended.left:
        return "remains", f"processes {ended.left} remain after {GONE_S:g} s"
    if "Traceback" in ended.text:
        return "bug", ended.text[-2000:]
    if ended.code not in ({0} if ended.by_itself else {-ending, 128 + ending, 0}):
        return "bug", f"exit code {ended.code}: {ended.text[-600:]}"
    return None


def _heed_all() -> None:
    for each in _SIGNALS[1:]:
        handler = signal.default_int_handler if each == signal.SIGINT else signal.SIG_DFL
        signal.signal(each, handler)


def _command(arguments: list[str], folder: Path, **values: float) -> list[str]:
    return [*_PROGRAM, *(each.format(folder=folder, **values) for each in arguments)]


def _session(leader: int) -> dict[int, float]:
    """Return the CPU times in s of the processes of a session that have not ended."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, *fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == leader and state not in "ZX":
            ticks = sum(map(int, fields[10:14]))  # its own, and those of children that have ended
            found[int(path.parent.name)] = ticks / os.sysconf("SC_CLK_TCK")
    return found


@cache
def recorded() -> Path:
    """Record a few volumes, and return their folder, which lasts as long as the program."""
    folder = Path(tempfile.mkdtemp(prefix="fuzz-recorded-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    command = _command(_COMMANDS["record"], folder, duration=3)
    subprocess.run(command, check=True, capture_output=True)
    return folder


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
