"""Figures of the runs of one method, with their intervals, and rows that compare two methods."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.following.analysis import AS_PUBLISHED, Run, Volumes, pooled_runs
from sonoservo.diagrams.studies.run_group import RunGroup, Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import StudyRow

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


class Comparison:
    """Runs of one experiment with both methods, and the rows made from them."""

    def __init__(self, outcomes: Sequence[Outcome], name: str, logs: Path | None = None) -> None:
        self.name = name
        self.ours = MethodRuns(outcomes, name, logs)
        self.published = MethodRuns(outcomes, name + AS_PUBLISHED, logs)
        self.rows: list[StudyRow] = []

    @property
    def runs(self) -> list[Run]:
        """Finished runs with our method."""
        return self.ours.runs

    def row(
        self, quantity: str, unit: str, figure: Callable[[MethodRuns], Value], **more: Any
    ) -> None:
        """Add a row with the same figure of both methods."""
        figures = figure(self.ours), figure(self.published)
        self.rows.append(StudyRow.of(self.name, quantity, unit, *figures, **more))

    def errors(self, name: str, quantity: str, unit: str, factor: float, **targets: float) -> None:
        """Add the rows of an error over all volumes that count: median, 95 % and largest."""
        for what, key, q in (("median", "median", 0.5), ("95 %", "p95", 0.95), ("largest", "", 1)):
            self.row(
                f"{quantity}, from 20 mm in view on, {what}",
                unit,
                partial(MethodRuns.error, name=name, q=q, factor=factor),
                target=targets.get(key),
            )

    def summed(self, quantity: str, unit: str, *path: str, **more: Any) -> None:
        """Add a row with the mean over runs of a figure of their summaries."""
        self.row(quantity, unit, lambda method: method.mean(lambda run: run.figure(*path)), **more)


def add_rest_rows(
    group: Comparison,
    known: Sequence[tuple[float | None, float | None]] = 3 * ((None, None),),
    share: float | None = None,
) -> None:
    """Add the rows of the features at rest: where a run converged, and its median over all."""
    group.row(
        "runs that converged", "%", lambda m: m.share(lambda run: run.converged()),
        target=share, wanted="at least",
    )  # fmt: skip
    for k, (name, (paper, target)) in enumerate(zip(("X", "Z", "Theta"), known, strict=True)):
        unit, factor = ("deg", _DEG) if name == "Theta" else ("mm", _MM)
        group.row(
            f"at rest where it converged, mean |{name}|",
            unit,
            partial(_at_rest, feature=k, factor=factor),
            paper=paper,
            target=target,
        )
        group.row(
            f"at rest, all runs, median |{name}|",
            unit,
            partial(_at_rest, feature=k, factor=factor, every=True),
        )


def _at_rest(method: MethodRuns, feature: int, factor: float, every: bool = False) -> Value:
    """Return the error of a feature at rest: of runs that converged, or the median of all."""

    def error(run: Run, estimated: bool) -> float:
        return factor * float(run.rest[int(estimated)][feature])

    figures = partial(error, estimated=False), partial(error, estimated=True)
    if every:
        return method.mean(*figures, np.median)
    return method.those(lambda run: run.converged()).mean(*figures)


def add_tracking_rows(group: Comparison) -> None:
    """Add the rows of the errors of tip and axis, and of failures of tracking."""
    add_error_rows(group)
    add_reliability_rows(group)


def add_error_rows(group: Comparison) -> None:
    """Add the rows of the errors of tip and axis."""
    group.errors("tip", "tip error", "mm", _MM)
    group.errors("axis", "axis error", "deg", _DEG)


def add_reliability_rows(group: Comparison, target: float | None = None) -> None:
    """Add the rows of failures of tracking, and of what an estimate says of itself."""

    def untracked(run: Run) -> float:
        counted = run.volumes.tracked[run.volumes.enough]
        return 100 * float(np.mean(~counted)) if len(counted) else np.nan

    def lost(run: Run) -> int:
        return int(np.sum(np.diff(run.volumes.lost.astype(int)) > 0))

    group.row("volumes not tracked, from 20 mm in view on", "%", lambda m: m.mean(untracked))
    group.row("times lost, all runs", "", lambda m: m.count(lost), target=target)
    add_false_start_rows(group, target)
    group.summed("tracking shown without a needle", "s", "tracking", "absent_s")
    group.summed("travel of the probe without a needle", "mm", "tracking", "absent_travel_mm")
    for what in ("tip", "axis", "velocity"):
        path = ("tracking", "consistency", what)
        group.row(f"truth inside the stated 95 %, {what}", "%", partial(_within, what=what))
        group.summed(f"normalised squared error, {what}", "", *path, "nees")


def _within(method: MethodRuns, what: str) -> Value:
    """Return the mean share of volumes with the truth inside the stated 95 %, in %."""

    def share(run: Run) -> float | None:
        value = run.figure("tracking", "consistency", what, "within_95")
        return None if value is None else 100 * value

    return method.mean(share)


def add_false_start_rows(group: Comparison, target: float | None = None) -> None:
    """Add the rows of tracks that began on something that is no needle."""
    group.row(
        "false starts, more than 10 mm off or without a needle, all runs",
        "",
        lambda method: method.count(lambda run: int(run.summary["detection"]["false_starts"])),
        target=target,
    )
