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
from dataclasses import dataclass
from pathlib import Path

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
    """Outcome of a case that a person can repeat by its description.

    A result that is neither "good" nor "refused" is a finding: "bug", "wrong", "slow", "memory",
    "died". The detail is a message or traceback; memory, also that which the data justify, is in
    bytes.
    """

    what: str
    result: str
    detail: str = ""
    justified: float = 0.0
    number: int = -1
    cpu_s: float = 0.0
    peak: float = 0.0

    @property
    def finding(self) -> bool:
        return self.result not in ("good", "refused")


def judge(what: str, case: Callable[[], float], names: str = "") -> Outcome:
    """Run a case that returns the bytes its data justify, and judge how it ends.

    It raises AssertionError if a result is wrong. The message of a refusal must contain ``names``.
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


def run(case: Case, numbers: range) -> list[Outcome]:
    """Run cases, and return their outcomes; a case that kills its worker is a finding too."""
    outcomes: list[Outcome] = []
    while len(outcomes) < len(numbers):
        outcomes += _run_batch(case, list(numbers[len(outcomes) :][:_BATCH]))
        print(f"{len(outcomes)} of {len(numbers)}", file=sys.stderr, flush=True)
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
