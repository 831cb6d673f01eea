"""Kept runs: which are missing, and whether those made again give the figures that were kept."""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

from sonoservo.diagrams.papers.registry import module_of
from sonoservo.diagrams.papers.results import by_case, case_digits, kept_records, require_addable
from sonoservo.diagrams.studies.study import Case, StudyOptions
from sonoservo.systems.files.refusals import ConfigurationError

_CLOCK = frozenset({"compute", "compute_ms", "compute_s", "track_time"})
"""Figures that a clock of the computer measured: no two runs have the same."""


@dataclass(frozen=True)
class Repeat:
    """A kept run that was made again: its name, and what differs first, empty if nothing does."""

    name: str
    difference: str


Choice = Callable[[Sequence[Case]], Sequence[Case]]


def choose_missing(paper: str) -> Choice:
    """Return the choice of those cases of a study of which no records are kept.

    ConfigurationError, then or when it chooses, if other code made those that are kept and the
    present one repeated none of them, or none is missing.
    """
    kept = by_case(require_addable(paper).outcomes)

    def choose(cases: Sequence[Case]) -> Sequence[Case]:
        missing = [each for each in cases if case_digits(each) not in kept]
        if not missing:
            raise ConfigurationError("--add: all these runs are kept already")
        return missing

    return choose


def repeat_kept_runs(paper: str, number: int, options: StudyOptions) -> list[Repeat]:
    """Make about ``number`` of a paper's kept runs again, and compare each with its record.

    They agree if they do to the six digits that records have. A study may run cases in several
    steps: of each step, some kept runs are made again. The cases of a step that keeps none, such as
    those from which an estimator learns, are all run. ConfigurationError if no records are kept, or
    the study makes none of their runs any more.
    """
    records = kept_records(paper)
    if records is None:
        raise ConfigurationError(f"--repeat: no records of runs are kept of {paper}")
    kept = by_case(records.outcomes)

    def choose(cases: Sequence[Case]) -> Sequence[Case]:
        experiments = {each.case.experiment for each in kept.values()}
        if experiments.isdisjoint(each.experiment for each in cases):
            return cases
        found = [case for case in cases if case_digits(case) in kept]
        if not found:
            raise ConfigurationError("--repeat: the study makes none of the kept runs any more")
        # By a hash, so that they are spread over the experiments, and the same ones each time.
        found.sort(key=lambda case: hashlib.sha256(case.key.encode()).digest())
        return found[: math.ceil(number * len(found) / len(kept))]

    repeats = []
    for outcome in module_of(paper, "reproduction").run(replace(options, choose=choose)):
        if (record := kept.get(case_digits(outcome.case))) is not None:
            one, other = ({"error": e.error, "result": e.result} for e in (outcome, record))
            repeats.append(Repeat(outcome.case.name, next(_differences(one, other), "")))
    return repeats


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
