"""Analysis of the records of the study of robustness: when a run is a success, and figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.study import Outcome
from sonoservo.systems.evaluation.intervals import (
    count_interval,
    mean_interval,
    proportion_interval,
    run_interval,
)
from sonoservo.systems.evaluation.success import KEPT, TrackedVolumes, finite_or_infinite

Floats = NDArray[np.float64]

_WORTH = 10.0
"""Travel of a probe after a ghost that counts as a chase, in mm."""


@dataclass(frozen=True, eq=False)
class Record(TrackedVolumes):
    """Run of one tracker; see `runs.record` and `TrackedVolumes`.

    `false_starts` is their number, `seconds` the simulated time, `shown_s` the time in s for which
    a needle is shown while there is none in the image, and `travel_mm` the distance that the probe
    is commanded meanwhile, None if nothing follows the tracker. `inside` tells whether the truth
    lies inside the stated 95 % of tip, axis and velocity: (v,) arrays of 1 or 0, NaN where nothing
    is stated.
    """

    false_starts: int
    seconds: float
    shown_s: float
    travel_mm: float | None
    inside: Mapping[str, Floats]

    @classmethod
    def kept_by(cls, kept: Mapping[str, Any]) -> "Record":
        """Return the record that a case has kept."""
        tip, axis = (np.array(kept[name], dtype=float) for name in ("tip_mm", "axis_deg"))
        return cls(
            tip=finite_or_infinite(tip),
            axis=finite_or_infinite(axis),
            tracking=np.array(kept["tracking"], dtype=bool),
            to_be_seen=np.array(kept["conspicuous_mm"], dtype=float),
            false_starts=int(kept["false_starts"]),
            seconds=float(kept["seconds"]),
            shown_s=float(kept["shown_s"]),
            travel_mm=kept["travel_mm"],
            inside={name: np.array(each, dtype=float) for name, each in kept["inside"].items()},
        )


@dataclass(frozen=True)
class Figure:
    """A figure with its 95 % interval; None if there is none."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


class Group:
    """Runs of one tracker in one experiment.

    `outcomes`: outcomes of the experiment's cases in which the tracker took part; `tracker`: kind
    of the tracker.
    """

    def __init__(self, outcomes: Sequence[Outcome], tracker: str) -> None:
        self.records = [Record.kept_by(each.result[tracker]) for each in outcomes if each]
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

    `value`: first strength studied at which less than 95 % of the runs succeed; None if there is
    none; `before`: last strength studied before it, or the last one of all; None if there is none;
    `plain`: whether 95 % of the runs succeed with every dial off. If not, no strength is a
    threshold.
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
    """Return the threshold of a dial."""
    before = None
    for value, share in points:
        if share.value is not None and share.value < 100 * KEPT:
            return Threshold(value, before)
        before = value
    return Threshold(None, before)
