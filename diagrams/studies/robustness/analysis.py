"""Analysis of the records of the study of robustness: when a run is a success, and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.run_group import RunGroup, Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.systems.evaluation.success import TrackedVolumes, finite_or_infinite

Floats = NDArray[np.float64]

_WORTH = 10.0  # travel of a probe after a ghost that counts as a chase, in mm


@dataclass(frozen=True, eq=False)
class Record(TrackedVolumes):
    """Run of one tracker; see `runs.record` and `TrackedVolumes`."""

    false_starts: int
    seconds: float  # simulated
    shown_s: float  # a needle is shown while there is none in the image
    travel_mm: float | None  # commanded meanwhile; None if nothing follows the tracker
    inside: Mapping[str, Floats]  # (v,) 1 or 0; NaN where nothing is stated

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


class Group(RunGroup[Record]):
    """Runs of one tracker, by its kind, in the outcomes of an experiment in which it took part."""

    def __init__(self, outcomes: Sequence[Outcome], tracker: str) -> None:
        finished = [Record.kept_by(each.result[tracker]) for each in outcomes if each]
        super().__init__(finished, len(outcomes))

    def quantile(self, error: str, q: float) -> Value:
        """Return a quantile of an error from the detection on; infinite if not found."""
        runs = [
            getattr(each, error)[each.judged] if each.judged.any() else np.array([np.inf])
            for each in self.runs
        ]
        return pooled([*runs, *self.failed * [np.array([np.inf])]], quantile_of(q))

    def inside(self, error: str) -> Value:
        """Return the share in % of truths inside the stated 95 % from the detection on."""
        stated = [each.inside[error][each.judged] for each in self.runs]
        runs = [100 * each[np.isfinite(each)] for each in stated]
        return pooled([each for each in runs if len(each)], lambda values: float(values.mean()))

    def false_starts_per_hour(self) -> Value:
        """Return the rate of false starts; a failed run has as many as the worst of the others."""
        if not self.runs:
            return Value()
        number = self.count(lambda each: each.false_starts)
        assert number.true is not None
        assert number.low is not None
        assert number.high is not None
        hours = sum(each.seconds for each in self.runs) / 3600 * self.total / len(self.runs)
        return Value(number.true / hours, low=number.low / hours, high=number.high / hours)


def chased(record: Record) -> bool:
    """Return True if the probe went 10 mm or more after a needle that is not in the image."""
    return (record.travel_mm or 0.0) >= _WORTH
