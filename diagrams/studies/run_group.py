"""Figures of a group of runs with their intervals; failed runs stay in the statistics."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.evaluation.intervals import count_interval, proportion_interval, run_interval

Floats = NDArray[np.float64]
RunT = TypeVar("RunT")


@dataclass(frozen=True)
class Value:
    """A figure of one method: true, estimated, and the 95 % interval; None if there is none."""

    true: float | None = None
    estimated: float | None = None
    low: float | None = None
    high: float | None = None
    share_of: int | None = None  # number of runs of a share in %


def pooled(runs: Sequence[Floats], statistic: Callable[[Floats], float]) -> Value:
    """Return a statistic of the values of all runs, (v,) each, with its interval over runs."""
    if not runs:
        return Value()
    return Value(statistic(np.concatenate(runs)), None, *run_interval(runs, statistic))


def quantile_of(q: float) -> Callable[[Floats], float]:
    """Return a function that takes the quantile of values, which is one of them."""
    return lambda values: float(np.quantile(values, q, method="inverted_cdf"))


class RunGroup(Generic[RunT]):
    """Runs of one method or tracker in one experiment, of which some may have failed."""

    def __init__(self, runs: Sequence[RunT], total: int) -> None:
        self.runs, self.total, self.failed = list(runs), total, total - len(runs)

    def mean(
        self,
        true: Callable[[RunT], float | None],
        estimated: Callable[[RunT], float | None] | None = None,
        statistic: Callable[[Floats], float] = np.mean,
    ) -> Value:
        """Return the mean over runs, or a statistic; a failed run has the worst of the others."""
        values, known = (
            self._with_failed(each) if each else np.zeros(0) for each in (true, estimated)
        )
        if len(values) == 0:
            return Value()
        other = float(statistic(known)) if len(known) else None
        return Value(float(statistic(values)), other, *run_interval(values, statistic))

    def those(self, good: Callable[[RunT], bool]) -> Self:
        """Return the finished runs for which something holds."""
        chosen = copy(self)
        chosen.runs = [run for run in self.runs if good(run)]
        chosen.failed, chosen.total = 0, len(chosen.runs)
        return chosen

    def largest(self, true: Callable[[RunT], float | None]) -> Value:
        """Return the largest value of all runs; infinite if one is unknown or a run failed."""
        values = [true(run) for run in self.runs]
        if not self.total:
            return Value()
        known = [np.inf if value is None else value for value in values]
        return Value(max([*known, *self.failed * [np.inf]]))

    def share(self, good: Callable[[RunT], bool]) -> Value:
        """Return the share of runs for which something holds, in %; for failed ones it does not."""
        if not self.total:
            return Value()
        number = sum(bool(good(run)) for run in self.runs)
        low, high = proportion_interval(number, self.total)
        return Value(100 * number / self.total, None, 100 * low, 100 * high, self.total)

    def count(self, number: Callable[[RunT], int]) -> Value:
        """Return the number of events in all runs; a failed run has as many as the worst."""
        if not self.total:
            return Value()
        numbers = [int(number(run)) for run in self.runs]
        count = sum(numbers) + self.failed * max(numbers, default=1)
        return Value(count, None, *count_interval(count))

    def _with_failed(self, figure: Callable[[RunT], float | None]) -> Floats:
        values = [value for run in self.runs if (value := figure(run)) is not None]
        known = [value for value in values if not np.isnan(value)]
        return np.array([*known, *(self.failed * [max(known, default=np.inf)])], dtype=float)
