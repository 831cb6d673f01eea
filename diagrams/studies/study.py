"""Runs of a study on all cores, with results kept on disk and failures isolated."""

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cache, partial
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, effective_n_jobs, parallel_config
from joblib.externals.loky import get_reusable_executor
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from sonoservo.systems.files.claims import claim_folder
from sonoservo.systems.files.writing import to_plain, write_json
from sonoservo.systems.signals.requirements import require

Work = Callable[["Case"], Mapping[str, Any]]

_SHOWS_RESULTS = ("display", "cli", "terminal", "plots", "report", "page", "analysis")
"""Endings of the names of folders and modules that do not affect results."""

_CASES_PER_PROCESS = 10
"""Number of cases after which a process is replaced, as Drake leaks some 20 MB per experiment."""

_WATCH_PERIOD = 0.2
"""Time in s between two looks of a process at its parent."""


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of the reproduction of any paper.

    Parameters
    ----------
    folder
        Folder of the study's files.
    quick
        Whether to make a few short runs only, as a functional check.
    seeds
        Number of seeds of each experiment; None for the study's own number.
    first_seed
        First seed of each experiment. Seeds below 100 are for reporting; parameters are tuned on
        others.
    jobs
        Number of processes; -1 for one per core.
    console
        Console on which to show progress, if any.
    """

    folder: Path
    quick: bool = False
    seeds: int | None = None
    first_seed: int = 0
    jobs: int = -1
    console: Console | None = None

    def __post_init__(self) -> None:
        if self.seeds is not None:
            require(self.seeds >= 1, "seeds", self.seeds, "1 or more")
        require(self.first_seed >= 0, "first_seed", self.first_seed, "0 or more")
        require(self.jobs >= 1 or self.jobs == -1, "jobs", self.jobs, "1 or more, or -1")

    def seed_range(self, number: int, quick_number: int) -> range:
        """Return an experiment's seeds, given their default numbers for full and quick studies."""
        own = quick_number if self.quick else number
        return range(self.first_seed, self.first_seed + (self.seeds or own))


@dataclass(frozen=True)
class Case:
    """One run of a study; it is hashable, and compares by its contents.

    Parameters
    ----------
    experiment
        Name of the study's experiment that it belongs to.
    seed
        Random seed of the run.
    settings
        Further settings of the run, in types that JSON has.

    Raises
    ------
    TypeError
        If JSON cannot hold the settings.
    """

    experiment: str
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        json.dumps(self.settings)

    def __hash__(self) -> int:
        return hash(self.key)

    @property
    def key(self) -> str:
        """Contents as one text."""
        return json.dumps(asdict(self), sort_keys=True)

    @property
    def name(self) -> str:
        """Name of its files: readable, and different for different contents."""
        digest = hashlib.sha256(self.key.encode()).hexdigest()[:8]
        return f"{self.experiment}_seed{self.seed:03d}_{digest}"


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case; falsy if the case failed.

    Parameters
    ----------
    case
        Case that was run.
    result
        Return value of the work, in types that JSON has; empty if it failed.
    error
        Error message; empty if it did not fail.
    wall_s
        Wall-clock time of the run, in s.
    """

    case: Case
    result: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""
    wall_s: float = 0.0

    def __bool__(self) -> bool:
        return not self.error


@cache
def code_fingerprint() -> str:
    """Return a digest of the package's files and of Drake's version.

    Code that only displays results (`_SHOWS_RESULTS`) is excluded: a better plot does not make runs
    out of date.
    """
    digest = hashlib.sha256(f"sonoservo {version('sonoservo')}, drake {version('drake')}".encode())
    for part in ("systems", "models", "diagrams"):
        folder = Path(str(files(f"sonoservo.{part}")))
        for path in sorted(folder.rglob("*")):
            names = path.relative_to(folder).with_suffix("").parts
            shows = any(name.endswith(_SHOWS_RESULTS) for name in names)
            if path.is_file() and not shows and "__pycache__" not in names:
                digest.update("/".join((part, *names)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def run_cases(
    work: Work,
    cases: Sequence[Case],
    folder: Path,
    *,
    jobs: int = -1,
    console: Console | None = None,
) -> list[Outcome]:
    """Run every case that has not been run yet, several at a time.

    Each outcome is written to a file of its own in ``folder`` as soon as it is known. An existing
    outcome is read instead if it was made by the same code with the same settings. Each process
    computes with one thread.

    Parameters
    ----------
    work
        Function that runs a case and returns the result to keep, in types that JSON or NumPy has.
        It must be importable, or a partial of an importable function. Any exception makes the case
        a failure.
    cases
        Cases to run, all different.
    folder
        Folder of the outcomes.
    jobs
        Number of processes; -1 for one per core, 1 to run the cases in this process.
    console
        Console on which to show progress, if any.

    Returns
    -------
    The outcomes, in the order of the cases.

    Raises
    ------
    ValueError
        If two cases are equal.
    ConfigurationError
        If another process runs cases in the same folder.
    KeyboardInterrupt
        If interrupted; finished outcomes are kept.
    """
    with claim_folder(folder):
        return _run_missing(work, cases, folder, jobs, console or Console(quiet=True))


def _run_missing(
    work: Work, cases: Sequence[Case], folder: Path, jobs: int, console: Console
) -> list[Outcome]:
    outcomes = {case: _read(_path(folder, case), case) for case in cases}
    if len(outcomes) < len(cases):
        raise ValueError(f"{len(cases)} cases, of which {len(outcomes)} differ; all must differ")
    pending = [case for case, outcome in outcomes.items() if outcome is None]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console) as bar:
        done = len(cases) - len(pending)
        task = bar.add_task("starting ...", total=len(cases), completed=done)
        for outcome in _run_all(work, pending, folder, jobs):
            outcomes[outcome.case] = outcome
            bar.update(task, advance=1, description=outcome.case.experiment)
            if not outcome:
                console.print(f"{outcome.case.name} failed: {outcome.error}", markup=False)
    return [outcome for outcome in outcomes.values() if outcome is not None]


def _run_all(work: Work, cases: list[Case], folder: Path, jobs: int) -> Iterator[Outcome]:
    """Run cases in rounds, each in fresh processes.

    Drake's Python systems are never freed, so a process must be replaced from time to time. A case
    that kills its process is identified by running the cases again one by one.
    """
    pending = dict.fromkeys(cases)
    most = together = _CASES_PER_PROCESS * effective_n_jobs(jobs)
    while pending:
        batch = list(pending)[:together]
        try:
            for outcome in _run_round(work, batch, folder, jobs if together > 1 else 2):
                del pending[outcome.case]
                yield outcome
            together = most
        except BrokenProcessPool:
            if together == 1:
                del pending[batch[0]]
                yield _keep(Outcome(batch[0], error="its process died"), folder)
                together = most
            else:
                together = 1


def _run_round(work: Work, cases: list[Case], folder: Path, jobs: int) -> Iterator[Outcome]:
    with parallel_config(
        "loky",
        n_jobs=jobs,
        inner_max_num_threads=1,
        initializer=partial(_follow_parent, os.getpid()),
    ):
        outcomes = Parallel(return_as="generator_unordered", batch_size=1)(
            delayed(_run_case)(work, case, folder) for case in cases
        )
    try:
        yield from outcomes
    finally:
        outcomes.close()
        get_reusable_executor(kill_workers=True).shutdown(kill_workers=True)


def _follow_parent(parent: int) -> None:
    """Leave Ctrl-C to the parent process, and end with it however it ends.

    Every process of a terminal receives Ctrl-C, and the parent process handles it.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_PERIOD)
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=watch, daemon=True).start()


def _run_case(work: Work, case: Case, folder: Path) -> Outcome:
    started = time.perf_counter()
    try:
        result, error = work(case), ""
    except Exception as exception:
        result, error = {}, f"{type(exception).__name__}: {exception}"
    return _keep(Outcome(case, result, error, time.perf_counter() - started), folder)


def _path(folder: Path, case: Case) -> Path:
    return folder / f"{case.name}.json"


def _keep(outcome: Outcome, folder: Path) -> Outcome:
    """Write an outcome to its file, and return it as it will be read.

    An outcome that cannot be written still counts, but is computed again the next time.
    """
    content = {"code": code_fingerprint(), **to_plain(asdict(outcome))}
    with suppress(OSError):
        write_json(_path(folder, outcome.case), {**content, "sha256": _digest(content)})
    return Outcome(outcome.case, content["result"], outcome.error, outcome.wall_s)


def _digest(content: Mapping[str, Any]) -> str:
    """Return the digest of an outcome's contents, by which an altered file is noticed."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _read(path: Path, case: Case) -> Outcome | None:
    """Read a case's outcome; None if there is none by the present code, or it was altered."""
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        intact = kept.pop("sha256") == _digest(kept)
        if not intact or kept.pop("code") != code_fingerprint() or kept.pop("case") != asdict(case):
            return None
        return Outcome(case, **kept)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
