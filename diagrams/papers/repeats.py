"""Kept runs: which are missing, and whether those made again give the figures that were kept."""

import hashlib
import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

from sonoservo.diagrams.papers.registry import module_of
from sonoservo.diagrams.papers.results import by_case, case_digits, require_addable, require_records
from sonoservo.diagrams.studies.fingerprint import is_outdated
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions
from sonoservo.systems.files.refusals import ConfigurationError

_CLOCK = frozenset({"compute", "compute_ms", "compute_s", "track_time"})
"""Figures that a clock of the computer measured: no two runs have the same."""

_PROBED = 3
"""Number of runs of an experiment that show whether the present code changes its figures."""


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


@dataclass(frozen=True)
class Refreshed:
    """What has become of kept runs that other code made."""

    outcomes: Sequence[Outcome]
    """Runs by the present code, of those experiments and trackers whose figures it changes."""
    same: int
    """Number of runs of the other experiments that it made again, with the same figures."""


def repeat_kept_runs(paper: str, number: int, options: StudyOptions) -> list[Repeat]:
    """Make about ``number`` of a paper's kept runs again, and compare each with its record.

    They agree if they do to the six digits that records have. A study may run cases in several
    steps: of each step, some kept runs are made again. The cases of a step that keeps none, such as
    those from which an estimator learns, are all run. ConfigurationError if no records are kept, or
    the study makes none of their runs any more.
    """
    kept = by_case(require_records(paper, "--repeat").outcomes)
    again = _made_again(
        paper, kept, options, lambda found: found[: math.ceil(number * len(found) / len(kept))]
    )
    return [Repeat(outcome.case.name, difference) for outcome, difference in again]


def refresh_kept_runs(paper: str, options: StudyOptions) -> Refreshed:
    """Make those kept runs again whose figures the present code changes.

    Of each experiment with runs by other code, and of each tracker in it, `_PROBED` are made again.
    If one differs, all are. Errors and steps are those of `repeat_kept_runs`.
    """
    kept = by_case(require_records(paper, "--refresh").outcomes)
    old = {_kind(each.case) for each in kept.values() if is_outdated(each.made_by)}
    if not old:
        return Refreshed([], 0)

    def of(kinds: Set[Hashable], number: int | None) -> Choice:
        def choose(found: Sequence[Case]) -> Sequence[Case]:
            by_kind: dict[Hashable, list[Case]] = {}
            for case in found:
                by_kind.setdefault(_kind(case), []).append(case)
            chosen = [
                each for kind, cases in by_kind.items() if kind in kinds for each in cases[:number]
            ]
            return chosen or found[:1]  # a step runs at least one

        return choose

    probed = _made_again(paper, kept, options, of(old, _PROBED))
    changed = {_kind(outcome.case) for outcome, difference in probed if difference}
    again = _made_again(paper, kept, options, of(changed, None)) if changed else []
    return Refreshed(
        [outcome for outcome, _ in again if _kind(outcome.case) in changed],
        sum(_kind(outcome.case) in old - changed for outcome, _ in probed),
    )


def _kind(case: Case) -> Hashable:
    """Return what cases have in common of which all change if the code of one does."""
    return case.experiment, *case.settings.get("trackers", ())


def _made_again(
    paper: str, kept: Mapping[str, Outcome], options: StudyOptions, choose: Choice
) -> list[tuple[Outcome, str]]:
    """Make the chosen ones of kept runs again; return each with what differs, empty if nothing.

    They are in the order of a hash, so that any number of them is spread over the experiments.
    """
    experiments = {each.case.experiment for each in kept.values()}

    def chosen(cases: Sequence[Case]) -> Sequence[Case]:
        if experiments.isdisjoint(each.experiment for each in cases):
            return cases
        found = [case for case in cases if case_digits(case) in kept]
        if not found:
            raise ConfigurationError("the study makes none of the kept runs any more")
        return choose(sorted(found, key=lambda case: hashlib.sha256(case.key.encode()).digest()))

    again = []
    for outcome in module_of(paper, "reproduction").run(replace(options, choose=chosen)):
        if (record := kept.get(case_digits(outcome.case))) is not None:
            one, other = ({"error": e.error, "result": e.result} for e in (outcome, record))
            again.append((outcome, next(_differences(one, other), "")))
    return again


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
