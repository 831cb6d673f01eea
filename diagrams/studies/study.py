"""Cases of a study, their outcomes, and the executors that run them."""

import hashlib
import json
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Protocol

from rich.console import Console

from sonoservo.diagrams.studies.store import Store
from sonoservo.systems.files.writing import to_plain
from sonoservo.systems.signals.requirements import at_least, check_bounds, require

CASES_PER_PROCESS = 10
"""Number of cases after which a process is replaced, as Drake leaks some 20 MB per experiment."""

DIED = "its process died"  # error of a case that ends its process


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options of the reproduction of any paper; see `run_cases` for the last ones."""

    folder: Path  # of the study's files
    quick: bool = False  # a few short runs only, as a functional check
    seeds: int | None = None  # largest number of seeds of an experiment
    first_seed: Annotated[int, at_least(0)] = 0
    only: str = ""  # beginning of the names of the experiments to run
    choose: Callable[[Sequence["Case"]], Sequence["Case"]] | None = None  # which of them to run
    jobs: int = -1
    cluster: "Executor | None" = None
    console: Console | None = None

    def __post_init__(self) -> None:
        if self.seeds is not None:
            require(self.seeds >= 1, "seeds", self.seeds, "1 or more")
        check_bounds(self)
        require(self.jobs >= 1 or self.jobs == -1, "jobs", self.jobs, "1 or more, or -1")

    def seed_range(self, number: int, quick_number: int) -> range:
        """Return an experiment's seeds, given their own numbers in full and quick studies."""
        own = quick_number if self.quick else number
        return range(self.first_seed, self.first_seed + min(own, self.seeds or own))


@dataclass(frozen=True)
class Case:
    """One run of a study; it is hashable, and compares by its contents."""

    experiment: str  # name of the study's experiment that it belongs to
    seed: int  # random seed of the run
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
    """Outcome of a case; falsy if the case failed."""

    case: Case
    result: Mapping[str, Any] = field(default_factory=dict)
    error: str = ""  # message; empty if it did not fail
    wall_s: float = 0.0  # wall-clock time, in s
    files: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    made_by: Mapping[str, str] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return not self.error


@dataclass(frozen=True)
class WithFiles:
    """Result of a case, and the contents of its files by name, with forward slashes."""

    result: Mapping[str, Any]
    files: Mapping[str, bytes]


Work = Callable[[Case], Mapping[str, Any] | WithFiles]


@dataclass(frozen=True)
class Finished:
    """A case that ended, with files not yet in the store."""

    outcome: Outcome
    files: Mapping[str, bytes] = field(default_factory=dict)
    lasting: bool = True  # otherwise, the case is run again the next time


class Executor(Protocol):
    """Runs cases, several at a time, on this machine or elsewhere."""

    @property
    def slots(self) -> int:
        """Number of cases that can run at the same time now."""

    def run(
        self, work: Work, cases: Sequence[Case], store: Store, notify: Callable[[str], None]
    ) -> Generator[Finished]:
        """Run cases, and yield each as it ends, in any order; closing the iterator ends all."""


def perform(work: Work, case: Case, store: Store | None = None) -> Finished:
    """Run a case in this process. Any exception makes it a failure."""
    started = time.perf_counter()
    result: Mapping[str, Any] = {}
    files: Mapping[str, bytes] = {}
    error, lasting = "", True
    try:
        made = work(case)
        if isinstance(made, WithFiles):
            result, files = to_plain(made.result), made.files
        else:
            result = to_plain(made)
    except Exception as exception:
        if isinstance(exception.__cause__, KeyboardInterrupt):  # in compiled code
            raise exception.__cause__ from None
        error = f"{type(exception).__name__}: {exception}"
    described = {
        name: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        for name, data in files.items()
    }
    if files and store is not None:
        try:
            store.write(files)
        except OSError as exception:  # a full disk; another time there may be room
            result, described, lasting = {}, {}, False
            error = f"{type(exception).__name__}: {exception}"
        files = {}
    wall_s = time.perf_counter() - started
    return Finished(Outcome(case, result, error, wall_s, described), files, lasting)
