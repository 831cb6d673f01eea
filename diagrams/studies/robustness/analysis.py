"""Analysis of the records of the study of robustness: when a run is a success, and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.study import Outcome
from sonoservo.systems.evaluation.statistics.intervals import proportion_interval
from sonoservo.systems.evaluation.statistics.run_intervals import (
    count_interval,
    mean_interval,
    run_interval,
)

Floats = NDArray[np.float64]

ENOUGH_MM = 10.0
"""Length of needle that stands out from which a volume counts, in mm."""

FOUND_MM, FOUND_DEG = 5.0, 5.0
"""Errors of tip and axis within which a tracked needle is the right one."""

KEPT = 0.95
"""Share of the volumes after the detection in which a kept needle is the right one."""

SUCCESS_MM, SUCCESS_DEG = 2.0, 2.0
"""Median errors of tip and axis of a success."""

_WORTH = 10.0
"""Travel of a probe after a ghost that counts as a chase, in mm."""


@dataclass(frozen=True, eq=False)
class Record:
    """Run of one tracker; see `runs.record`.

    Parameters
    ----------
    tip, axis
        (v,) errors in mm and deg; infinite without an estimate.
    tracking
        (v,) mask of the volumes that confirmed a needle.
    conspicuous
        (v,) length of the true needle that stands out in the volume, in mm.
    false_starts
        Number of false starts.
    seconds
        Simulated time in s.
    shown_s
        Time in s for which a needle is shown while there is none in the image.
    travel_mm
        Distance that the probe is commanded meanwhile in mm; None if nothing follows the tracker.
    inside
        Whether the truth lies inside the stated 95 % of tip, axis and velocity: (v,) arrays of 1 or
        0 each, NaN where nothing is stated.
    """

    tip: Floats
    axis: Floats
    tracking: NDArray[np.bool_]
    conspicuous: Floats
    false_starts: int
    seconds: float
    shown_s: float
    travel_mm: float | None
    inside: Mapping[str, Floats]

    @classmethod
    def of(cls, kept: Mapping[str, Any]) -> "Record":
        """Return the record that a case has kept."""
        tip, axis = (np.array(kept[name], dtype=float) for name in ("tip_mm", "axis_deg"))
        return cls(
            tip=np.where(np.isfinite(tip), tip, np.inf),
            axis=np.where(np.isfinite(axis), axis, np.inf),
            tracking=np.array(kept["tracking"], dtype=bool),
            conspicuous=np.array(kept["conspicuous_mm"], dtype=float),
            false_starts=int(kept["false_starts"]),
            seconds=float(kept["seconds"]),
            shown_s=float(kept["shown_s"]),
            travel_mm=kept["travel_mm"],
            inside={name: np.array(each, dtype=float) for name, each in kept["inside"].items()},
        )

    @cached_property
    def right(self) -> NDArray[np.bool_]:
        """(v,) mask of the volumes in which the right needle is tracked."""
        return self.tracking & (self.tip <= FOUND_MM) & (self.axis <= FOUND_DEG)

    @property
    def found(self) -> bool:
        """True if the right needle is tracked at all."""
        return bool(self.right.any())

    @cached_property
    def judged(self) -> NDArray[np.bool_]:
        """(v,) mask of the volumes from the detection on with enough of the needle to be seen."""
        return (np.cumsum(self.right) > 0) & (self.conspicuous >= ENOUGH_MM)

    @property
    def kept(self) -> bool:
        """True if the needle is found, and the right one is tracked in 95 % of these volumes."""
        return bool(self.judged.any() and self.right[self.judged].mean() >= KEPT)

    @property
    def success(self) -> bool:
        """True if the needle is kept, with median errors of at most 2 mm and 2 deg."""
        if not self.kept:
            return False
        tip, axis = (np.median(each[self.judged]) for each in (self.tip, self.axis))
        return bool(tip <= SUCCESS_MM and axis <= SUCCESS_DEG)


@dataclass(frozen=True)
class Figure:
    """A figure with its 95 % interval; None if there is none."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


class Group:
    """Runs of one tracker in one experiment.

    Parameters
    ----------
    outcomes
        Outcomes of the experiment's cases in which the tracker took part.
    tracker
        Kind of the tracker.
    """

    def __init__(self, outcomes: Sequence[Outcome], tracker: str) -> None:
        self.records = [Record.of(each.result[tracker]) for each in outcomes if each]
        self.total = len(outcomes)

    @property
    def failed(self) -> int:
        """Number of runs that ended with an error."""
        return self.total - len(self.records)

    def share(self, good: Callable[[Record], bool]) -> Figure:
        """Return the share of runs for which something holds, in %; for failed ones it does not."""
        if not self.total:
            return Figure()
        number = sum(good(each) for each in self.records)
        low, high = proportion_interval(number, self.total)
        return Figure(100 * number / self.total, 100 * low, 100 * high)

    def quantile(self, error: str, q: float) -> Figure:
        """Return a quantile of an error over the volumes from the detection on.

        Volumes without an estimate count as infinite errors. So does the volume that stands for a
        run in which the needle was not found, or that failed.

        Parameters
        ----------
        error
            "tip" or "axis".
        q
            Share of the volumes below the quantile.
        """
        runs = [
            getattr(each, error)[each.judged] if each.judged.any() else np.array([np.inf])
            for each in self.records
        ]
        runs += self.failed * [np.array([np.inf])]
        return _pooled(runs, lambda values: float(np.quantile(values, q, method="inverted_cdf")))

    def inside(self, error: str) -> Figure:
        """Return the share of truths inside the stated 95 % from the detection on, in %.

        Only volumes with a stated uncertainty count, so runs in which the needle was not found, or
        that failed, do not.

        Parameters
        ----------
        error
            "tip", "axis" or "velocity".
        """
        stated = [each.inside[error][each.judged] for each in self.records]
        runs = [100 * each[np.isfinite(each)] for each in stated]
        return _pooled([each for each in runs if len(each)], lambda values: float(values.mean()))

    def false_starts_per_hour(self) -> Figure:
        """Return the rate of false starts; a failed run has as many as the worst of the others."""
        if not self.records:
            return Figure()
        counts = [each.false_starts for each in self.records]
        number = sum(counts) + self.failed * max(counts)
        hours = sum(each.seconds for each in self.records) / 3600
        hours *= self.total / len(self.records)
        return Figure(number / hours, *(each / hours for each in count_interval(number)))

    def mean(self, value: Callable[[Record], float]) -> Figure:
        """Return the mean over runs; a failed run has the largest value of the others."""
        values = [value(each) for each in self.records]
        values += self.failed * [max(values, default=np.inf)]
        if not values:
            return Figure()
        return Figure(float(np.mean(values)), *mean_interval(np.array(values)))

    def largest(self, value: Callable[[Record], float]) -> Figure:
        """Return the largest value of all runs; infinite if a run failed."""
        values = [*(value(each) for each in self.records), *self.failed * [np.inf]]
        return Figure(max(values)) if values else Figure()


def _pooled(runs: Sequence[Floats], statistic: Callable[[Floats], float]) -> Figure:
    """Return a statistic of the values of all runs, (v,) each, with its interval over runs."""
    if not runs:
        return Figure()
    return Figure(statistic(np.concatenate(runs)), *run_interval(runs, statistic))


def chased(record: Record) -> bool:
    """Return True if the probe went 10 mm or more after a needle that is not in the image."""
    return (record.travel_mm or 0.0) >= _WORTH


@dataclass(frozen=True)
class Threshold:
    """Strength of a dial at which success falls under 95 %, in the dial's own unit.

    Parameters
    ----------
    value
        First strength studied at which less than 95 % of the runs succeed; None if there is none.
    before
        Last strength studied before it, or the last one of all; None if there is none.
    plain
        Whether 95 % of the runs succeed with every dial off. If not, no strength is a threshold.
    """

    value: float | None
    before: float | None
    plain: bool = True

    def __str__(self) -> str:
        if not self.plain:
            return "no threshold"
        if self.value is None:
            return "not studied" if self.before is None else f"beyond {self.before:.3g}"
        return "below the first strength" if self.before is None else f"{self.value:.3g}"


def threshold(points: Sequence[tuple[float, Figure]]) -> Threshold:
    """Return the threshold of a dial.

    Parameters
    ----------
    points
        Value of the dial and share of successes in % at each strength studied, the weakest first.
    """
    before = None
    for value, share in points:
        if share.value is not None and share.value < 100 * KEPT:
            return Threshold(value, before)
        before = value
    return Threshold(None, before)
