"""Runs cases in forked workers, each with a limit of CPU time and of memory."""

import ctypes
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sonoservo.systems.files.refusals import MAX_MESSAGE, ConfigurationError

CPU_S = 10.0
"""CPU time in s that a case may take."""

MEMORY = 1e9
"""Memory in bytes that a case may take beyond what its data justify."""

_BATCH = 200
"""Number of cases after which a worker is replaced."""

Case = Callable[[int, Path], "Outcome"]
"""Function that runs the case of a number in a folder of its own."""


@dataclass
class Outcome:
    """Outcome of a case.

    Parameters
    ----------
    what
        Short description of the case, from which a person can repeat it.
    result
        "good" or "refused"; anything else is a finding: "bug", "wrong", "slow", "memory", "died".
    detail
        Message or traceback.
    justified
        Memory in bytes that the data justify.
    """

    what: str
    result: str
    detail: str = ""
    justified: float = 0.0
    number: int = -1
    cpu_s: float = 0.0
    peak: float = 0.0
    extra: dict[str, Any] = field(default_factory=dict)

    @property
    def finding(self) -> bool:
        return self.result not in ("good", "refused")


def judge(what: str, case: Callable[[], float], names: str = "") -> Outcome:
    """Run a case that returns the bytes its data justify, and judge how it ends.

    Parameters
    ----------
    what
        Description of the case.
    case
        Function to run; it raises AssertionError if a result is wrong.
    names
        Text that the message of a refusal must contain, such as the file's name.
    """
    try:
        return Outcome(what, "good", justified=case())
    except ConfigurationError as error:
        text = str(error)
        wrong = len(text) > MAX_MESSAGE or "\n" in text or not text.isprintable()
        wrong = wrong or names not in text or "more memory than there is" in text
        return Outcome(what, "message" if wrong else "refused", text)
    except AssertionError:
        return Outcome(what, "wrong", traceback.format_exc())
    except MemoryError:
        return Outcome(what, "memory", traceback.format_exc())
    except BaseException:
        return Outcome(what, "bug", traceback.format_exc())


class Keep:
    """File to which outcomes are appended as they come, so that an ended run can go on.

    Parameters
    ----------
    path
        Path of the file; None keeps nothing.
    kind
        Kind of the cases. Outcomes of several kinds can share a file.
    """

    def __init__(self, path: Path | None = None, kind: str = "") -> None:
        self._path, self._kind = path, kind

    def read(self) -> dict[int, Outcome]:
        """Return the outcomes of earlier runs by their numbers; findings are to be run again."""
        if self._path is None or not self._path.exists():
            return {}
        rows = [json.loads(line) for line in self._path.read_text().splitlines()]
        outcomes = [Outcome(**row["outcome"]) for row in rows if row["kind"] == self._kind]
        return {outcome.number: outcome for outcome in outcomes if not outcome.finding}

    def append(self, outcome: Outcome) -> None:
        """Append an outcome."""
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"kind": self._kind, "outcome": outcome.__dict__}) + "\n")


def run(
    case: Case, numbers: range, *, keep: Keep | None = None, report_s: float = 30.0
) -> list[Outcome]:
    """Run cases, and return their outcomes; a case that kills its worker is a finding too."""
    keep = keep or Keep()
    known = keep.read()
    outcomes = [known[number] for number in numbers if number in known]
    reported = time.monotonic()
    numbers_left = [number for number in numbers if number not in known]
    while numbers_left:
        batch = numbers_left[:_BATCH]
        done = 0
        for outcome in _run_batch(case, batch):
            outcomes.append(outcome)
            keep.append(outcome)
            done += 1
            if time.monotonic() > reported + report_s:
                print(f"{len(outcomes)} of {len(numbers)}", file=sys.stderr, flush=True)
                reported = time.monotonic()
        numbers_left = numbers_left[done:]
    return outcomes


def _run_batch(case: Case, numbers: list[int]) -> Iterator[Outcome]:
    """Run cases in one forked worker; the last one yielded is the one that killed it, if any."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(read)
        try:
            _work(case, numbers, write)
        finally:
            os._exit(0)
    os.close(write)
    done = 0
    with os.fdopen(read, encoding="utf-8") as lines:
        for line in lines:
            done += 1
            yield Outcome(**json.loads(line))
    _, status = os.waitpid(child, 0)
    if done < len(numbers):
        number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        result = "slow" if number == signal.SIGPROF else "died"
        yield Outcome("?", result, f"signal {number}", number=numbers[done])


def _work(case: Case, numbers: list[int], write: int) -> None:
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # ends with its parent
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(1, 2)
    size = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
    limit = int(size + 6 * MEMORY)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, os.fdopen(write, "w") as out:
        for number in numbers:
            here = Path(folder) / str(number)
            here.mkdir()
            Path("/proc/self/clear_refs").write_text("5")  # forgets the peak
            before, started = _status("VmRSS"), time.process_time()
            signal.setitimer(signal.ITIMER_PROF, 1.5 * CPU_S)
            outcome = case(number, here)
            signal.setitimer(signal.ITIMER_PROF, 0)
            outcome.number = number
            outcome.cpu_s = time.process_time() - started
            outcome.peak = _status("VmHWM") - before
            if not outcome.finding and outcome.cpu_s > CPU_S:
                outcome.result = "slow"
            if not outcome.finding and outcome.peak > MEMORY + outcome.justified:
                outcome.result, outcome.detail = "memory", f"{outcome.peak / 1e9:.2f} GB"
            out.write(json.dumps(outcome.__dict__) + "\n")
            out.flush()
            for path in sorted(here.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


def _status(name: str) -> float:
    text = Path("/proc/self/status").read_text()
    return 1024.0 * int(text.partition(f"{name}:")[2].split()[0])


def summary(name: str, outcomes: list[Outcome]) -> str:
    """Return a line with the numbers of outcomes, and the largest CPU time and memory."""
    counts = Counter(outcome.result for outcome in outcomes)
    slowest = max(outcomes, key=lambda outcome: outcome.cpu_s)
    largest = max(outcomes, key=lambda outcome: outcome.peak)
    return (
        f"{name}: {len(outcomes)} cases, {dict(counts)}; most CPU {slowest.cpu_s:.1f} s "
        f"(case {slowest.number}), most memory {largest.peak / 1e6:.0f} MB (case {largest.number})"
    )
