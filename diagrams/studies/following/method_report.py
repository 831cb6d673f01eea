"""Figures of the runs of one method, with their intervals, and rows that compare two methods."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.following.analysis import Run, Volumes, pooled_runs
from sonoservo.diagrams.studies.following.cases import AS_PUBLISHED
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import StudyRow, can_be_judged
from sonoservo.systems.evaluation.intervals import (
    count_interval,
    mean_interval,
    proportion_interval,
    run_interval,
)

Floats = NDArray[np.float64]

_MM, _DEG = 1e3, float(np.rad2deg(1))


@dataclass(frozen=True)
class Value:
    """A figure of one method: true, estimated, and the 95 % interval; None if there is none.

    A share in % also has its number of runs.
    """

    true: float | None = None
    estimated: float | None = None
    low: float | None = None
    high: float | None = None
    share_of: int | None = None


class MethodRuns:
    """Runs of one experiment with one method.

    `outcomes`: outcomes of all experiments; `name`: name of the experiment; `logs`: folder of the
    logs, if there are any.
    """

    def __init__(self, outcomes: Sequence[Outcome], name: str, logs: Path | None = None) -> None:
        mine = [each for each in outcomes if each.case.experiment == name]
        self.runs = [Run(each, logs) for each in mine if each]
        self.failed = len(mine) - len(self.runs)
        self.total = len(mine)

    def error(self, name: str, q: float, factor: float) -> Value:
        """Return a quantile over all volumes of one of the `Volumes`' errors, times a factor."""
        return self.quantile(lambda volumes: factor * getattr(volumes, name), q)

    def quantile(self, values: Callable[[Volumes], Floats], q: float) -> Value:
        """Return a quantile over the volumes of all runs; failed runs count as infinite errors."""

        def figure(values: Floats) -> float:
            return float(np.quantile(values, q, method="inverted_cdf"))

        runs = pooled_runs(self.runs, self.failed, values)
        runs = [each for each in runs if len(each)]
        if not runs:
            return Value()
        low, high = run_interval(runs, figure)
        return Value(figure(np.concatenate(runs)), low=low, high=high)

    def mean(
        self,
        true: Callable[[Run], float | None],
        estimated: Callable[[Run], float | None] | None = None,
    ) -> Value:
        """Return the mean over runs; a failed run has the worst value of the others."""
        values = self._with_failed(true)
        if len(values) == 0:
            return Value()
        low, high = mean_interval(values)
        known = self._with_failed(estimated) if estimated else np.zeros(0)
        mean = float(np.mean(known)) if len(known) else None
        return Value(float(np.mean(values)), mean, low, high)

    def median(
        self, true: Callable[[Run], float | None], estimated: Callable[[Run], float | None]
    ) -> Value:
        """Return the median over runs; a failed run has the worst value of the others."""
        values = self._with_failed(true)
        if len(values) == 0:
            return Value()
        low, high = run_interval(list(values[:, np.newaxis]), _median)
        return Value(_median(values), _median(self._with_failed(estimated)), low, high)

    def those(self, good: Callable[[Run], bool]) -> "MethodRuns":
        """Return the finished runs for which something holds."""
        chosen = copy(self)
        chosen.runs = [run for run in self.runs if good(run)]
        chosen.failed, chosen.total = 0, len(chosen.runs)
        return chosen

    def largest(self, true: Callable[[Run], float | None]) -> Value:
        """Return the largest value of all runs; infinite if one is unknown or a run failed."""
        values = [true(run) for run in self.runs]
        if not self.total:
            return Value()
        known = [np.inf if value is None else value for value in values]
        return Value(max([*known, *self.failed * [np.inf]]))

    def share(self, good: Callable[[Run], bool]) -> Value:
        """Return the share of runs for which something holds, in %; for failed ones it does not."""
        if not self.total:
            return Value()
        number = sum(bool(good(run)) for run in self.runs)
        low, high = proportion_interval(number, self.total)
        return Value(100 * number / self.total, None, 100 * low, 100 * high, self.total)

    def count(self, number: Callable[[Run], int]) -> Value:
        """Return the number of events in all runs; a failed run has as many as the worst."""
        if not self.total:
            return Value()
        numbers = [int(number(run)) for run in self.runs]
        count = sum(numbers) + self.failed * max(numbers, default=1)
        low, high = count_interval(count)
        return Value(count, low=low, high=high)

    def _with_failed(self, figure: Callable[[Run], float | None]) -> Floats:
        values = [value for run in self.runs if (value := figure(run)) is not None]
        known = [value for value in values if not np.isnan(value)]
        return np.array([*known, *(self.failed * [max(known, default=np.inf)])], dtype=float)


class Comparison:
    """Runs of one experiment with both methods, and the rows made from them.

    `outcomes`, `name`, `logs`: see `MethodRuns`.
    """

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
        ours, published = figure(self.ours), figure(self.published)
        target = more.get("target")
        if target is not None and ours.share_of is not None:
            judged = can_be_judged(ours.share_of, target, more.get("wanted", "at most"))
            more["target"] = target if judged else None
        self.rows.append(
            StudyRow(
                experiment=self.name,
                quantity=quantity,
                unit=unit,
                true=ours.true,
                estimated=ours.estimated,
                low=ours.low,
                high=ours.high,
                published_true=published.true,
                published_estimated=published.estimated,
                published_low=published.low,
                published_high=published.high,
                **more,
            )
        )

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
    """Add the rows of the features at rest: where a run converged, and its median over all.

    A mean over all runs would tell how far the runs that failed happened to go.
    """
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
        return method.median(*figures)
    return method.those(lambda run: run.converged()).mean(*figures)


def _median(values: Floats) -> float:
    return float(np.median(values))


_MM, _DEG = 1e3, float(np.rad2deg(1))


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
