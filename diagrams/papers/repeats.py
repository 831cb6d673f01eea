"""Kept runs that are made again, and whether they give the figures that were kept."""

import hashlib
import math
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import zip_longest
from typing import Any

from sonoservo.diagrams.papers.registry import reproduce
from sonoservo.diagrams.papers.results import kept_records
from sonoservo.diagrams.studies.processes import Processes
from sonoservo.diagrams.studies.store import Store
from sonoservo.diagrams.studies.study import Case, Executor, Finished, Outcome, StudyOptions, Work
from sonoservo.systems.files.refusals import ConfigurationError

_CLOCK = frozenset({"compute", "compute_ms", "seconds", "track_time"})
"""Figures that a clock of the computer measured: no two runs have the same."""


@dataclass(frozen=True)
class Repeat:
    """A kept run that was made again: its name, and what differs first, empty if nothing does."""

    name: str
    difference: str


class _Repeating:
    """Executor that makes a few of the kept runs again, and all that come before them.

    A study may run cases in several steps: of each step, some kept runs are made again. The cases
    of a step that keeps none, such as those from which an estimator learns, are all run.
    """

    def __init__(self, executor: Executor, kept: Sequence[Outcome], number: int) -> None:
        self._executor, self._kept, self._number = executor, kept, number
        self.repeats: list[Repeat] = []

    @property
    def slots(self) -> int:
        """Number of slots of the executor behind it."""
        return self._executor.slots

    def run(
        self, work: Work, cases: Sequence[Case], store: Store, notify: Callable[[str], None]
    ) -> Generator[Finished]:
        """Run the chosen cases; see `Executor`."""
        kept = {case: found for case in cases if (found := self._record(case)) is not None}
        chosen = cases
        if {each.experiment for each in cases} & {each.case.experiment for each in self._kept}:
            # By a hash, so that they are spread over the experiments, and the same ones each time.
            number = math.ceil(self._number * len(kept) / len(self._kept))
            chosen = sorted(kept, key=lambda case: hashlib.sha256(case.key.encode()).digest())
            chosen = chosen[:number]
            if not chosen:
                raise ConfigurationError("--repeat: the study makes none of the kept runs any more")
        for finished in self._executor.run(work, chosen, store, notify):
            outcome = finished.outcome
            if (record := kept.get(outcome.case)) is not None:
                one, other = (
                    {"error": each.error, "result": each.result} for each in (outcome, record)
                )
                difference = next(_differences(one, other), "")
                self.repeats.append(Repeat(outcome.case.name, difference))
            yield finished

    def _record(self, case: Case) -> Outcome | None:
        """Return the record of a case, whose settings have the digits that records keep."""
        alike = (
            each
            for each in self._kept
            if (each.case.experiment, each.case.seed) == (case.experiment, case.seed)
        )
        mine = asdict(case)
        return next((each for each in alike if not [*_differences(mine, asdict(each.case))]), None)


def repeat_kept_runs(paper: str, number: int, options: StudyOptions) -> list[Repeat]:
    """Make about ``number`` of a paper's kept runs again, and compare each with its record.

    They agree if they do to the six digits that records have. ConfigurationError if no records are
    kept, or the study makes none of their runs any more.
    """
    records = kept_records(paper)
    if records is None:
        raise ConfigurationError(f"--repeat: no records of runs are kept of {paper}")
    executor = options.cluster or Processes(options.jobs)
    repeating = _Repeating(executor, records.outcomes, number)
    reproduce(paper, replace(options, cluster=repeating))
    return repeating.repeats


def _differences(one: Any, other: Any, path: str = "") -> Iterator[str]:
    """Yield where two values of JSON differ in more than the digits that records keep."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys((*one, *other)):
            if key not in _CLOCK:
                yield from _differences(one.get(key), other.get(key), f"{path}.{key}".lstrip("."))
    elif isinstance(one, list | tuple) and isinstance(other, list | tuple):
        for number, (a, b) in enumerate(zip_longest(one, other)):
            yield from _differences(a, b, f"{path}[{number}]")
    elif isinstance(one, float) and isinstance(other, float):
        if f"{one:.6g}" != f"{other:.6g}":
            yield f"{path}: {one:.6g}, kept {other:.6g}"
    elif one != other:
        yield f"{path}: {one}, kept {other}"
