"""Figures of the runs of one method, with their intervals, and rows that compare two methods."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, Run, Volumes, pooled_runs
from sonoservo.diagrams.studies.run_group import RunGroup, Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Side, StudyRow

Floats = NDArray[np.float64]

_MM, _DEG = 1e3, float(np.rad2deg(1))


class MethodRuns(RunGroup[Run]):
    """Runs of one experiment, by its name, with one method."""

    def __init__(self, outcomes: Sequence[Outcome], name: str, logs: Path | None = None) -> None:
        mine = [each for each in outcomes if each.case.experiment == name]
        super().__init__([Run(each, logs) for each in mine if each], len(mine))

    def error(self, name: str, q: float, factor: float) -> Value:
        """Return a quantile over all volumes of one of the `Volumes`' errors, times a factor."""
        return self.quantile(lambda volumes: factor * getattr(volumes, name), q)

    def quantile(self, values: Callable[[Volumes], Floats], q: float) -> Value:
        """Return a quantile over the volumes of all runs; failed runs count as infinite errors."""
        runs = pooled_runs(self.runs, self.failed, values)
        return pooled([each for each in runs if len(each)], quantile_of(q))


@dataclass(frozen=True)
class Quantity:
    """A quantity with its unit, its figure of a method's runs, the paper's, and the target."""

    name: str
    unit: str
    figure: Callable[[MethodRuns], Value]
    paper: float | None = None
    target: float | None = None
    wanted: Side = "at most"


class Comparison:
    """Runs of one experiment with both methods."""

    def __init__(self, outcomes: Sequence[Outcome], name: str, logs: Path | None = None) -> None:
        self.name = name
        self.ours = MethodRuns(outcomes, name, logs)
        self.published = MethodRuns(outcomes, name + AS_PUBLISHED, logs)

    def rows(self, quantities: Iterable[Quantity]) -> list[StudyRow]:
        """Return a row for each quantity, with the figures of both methods."""
        return [
            StudyRow.of(
                self.name, each.name, each.unit, each.figure(self.ours),
                each.figure(self.published),
                paper=each.paper, target=each.target, wanted=each.wanted,
            )
            for each in quantities
        ]  # fmt: skip


_QUANTILES = {"median": 0.5, "95 %": 0.95, "largest": 1.0}


def errors(
    column: str, name: str, unit: str, factor: float, **targets: float
) -> tuple[Quantity, ...]:
    """Return an error over all volumes that count: median, 95 % and largest."""
    keys = {"median": "median", "95 %": "p95"}
    return tuple(
        Quantity(
            f"{name}, from 20 mm in view on, {what}", unit,
            partial(MethodRuns.error, name=column, q=q, factor=factor),
            target=targets.get(keys.get(what, "")),
        )
        for what, q in _QUANTILES.items()
    )  # fmt: skip


ERRORS = (*errors("tip", "tip error", "mm", _MM), *errors("axis", "axis error", "deg", _DEG))
"""Errors of tip and axis."""


def summed(name: str, unit: str, *path: str, paper: float | None = None) -> Quantity:
    """Return the mean over runs of a figure of their summaries."""
    return Quantity(name, unit, lambda method: method.mean(lambda run: run.figure(*path)), paper)


def converged(straight: bool = True) -> Callable[[MethodRuns], Value]:
    """Return the figure that is the share of runs which converged."""
    return lambda method: method.share(lambda run: run.converged(straight))


def at_rest(
    known: Sequence[tuple[float | None, float | None]] = 3 * ((None, None),),
    share: float | None = None,
) -> list[Quantity]:
    """Return the features at rest: where a run converged, and the median over all runs."""
    rows = [Quantity("runs that converged", "%", converged(), target=share, wanted="at least")]
    for k, (name, (paper, target)) in enumerate(zip(("X", "Z", "Theta"), known, strict=True)):
        unit, factor = ("deg", _DEG) if name == "Theta" else ("mm", _MM)
        figure = partial(_at_rest, feature=k, factor=factor)
        where = f"at rest where it converged, mean |{name}|"
        rows.append(Quantity(where, unit, figure, paper, target))
        every = partial(figure, every=True)
        rows.append(Quantity(f"at rest, all runs, median |{name}|", unit, every))
    return rows


def _at_rest(method: MethodRuns, feature: int, factor: float, every: bool = False) -> Value:
    """Return the error of a feature at rest: of runs that converged, or the median of all."""

    def error(run: Run, estimated: bool) -> float:
        return factor * float(run.rest[int(estimated)][feature])

    figures = partial(error, estimated=False), partial(error, estimated=True)
    if every:
        return method.mean(*figures, np.median)
    return method.those(lambda run: run.converged()).mean(*figures)


def reliability(target: float | None = None) -> list[Quantity]:
    """Return the failures of tracking, and what an estimate says of itself."""
    rows = [
        Quantity("volumes not tracked, from 20 mm in view on", "%", lambda m: m.mean(_untracked)),
        Quantity("times lost, all runs", "", lambda m: m.count(_lost), target=target),
        false_starts(target),
        summed("tracking shown without a needle", "s", "tracking", "absent_s"),
        summed("travel of the probe without a needle", "mm", "tracking", "absent_travel_mm"),
    ]
    for what in ("tip", "axis", "velocity"):
        within = partial(_within, what=what)
        rows.append(Quantity(f"truth inside the stated 95 %, {what}", "%", within))
        path = ("tracking", "consistency", what, "nees")
        rows.append(summed(f"normalised squared error, {what}", "", *path))
    return rows


def false_starts(target: float | None = None) -> Quantity:
    """Return the number of tracks that began on something that is no needle."""
    return Quantity(
        "false starts, more than 10 mm off or without a needle, all runs", "",
        lambda method: method.count(lambda run: int(run.summary["detection"]["false_starts"])),
        target=target,
    )  # fmt: skip


def _untracked(run: Run) -> float:
    counted = run.volumes.tracked[run.volumes.enough]
    return 100 * float(np.mean(~counted)) if len(counted) else np.nan


def _lost(run: Run) -> int:
    return int(np.sum(np.diff(run.volumes.lost.astype(int)) > 0))


def _within(method: MethodRuns, what: str) -> Value:
    """Return the mean share of volumes with the truth inside the stated 95 %, in %."""

    def share(run: Run) -> float | None:
        value = run.figure("tracking", "consistency", what, "within_95")
        return None if value is None else 100 * value

    return method.mean(share)
