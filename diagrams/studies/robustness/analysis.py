"""Analysis of the records of the study of robustness: when a run is a success, and figures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.run_group import RunGroup, Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.systems.evaluation.success import KEPT, TrackedVolumes, finite_or_infinite

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


@dataclass(frozen=True)
class Threshold:
    """Strengths of a dial between which success falls under 95 %, in the dial's own unit.

    A strength counts as kept or failed if the 95 % interval of its share lies on that side.
    """

    kept: float | None = None  # last of the first strengths that are all kept, if any
    failed: float | None = None  # first of the last strengths that all fail, if any
    decided: bool = True  # whether every strength studied is one of these
    plain: bool = True  # False if runs fail with every dial off

    def __str__(self) -> str:
        if not self.plain:
            return "no threshold"
        kept, failed = (None if x is None else f"{x:.3g}" for x in (self.kept, self.failed))
        if self.decided:
            if failed is None:
                return "not studied" if kept is None else f"beyond {kept}"
            return "below the first strength" if kept is None else failed
        if failed is None:
            return "undecided" if kept is None else f"undecided, beyond {kept}"
        return f"undecided, up to {failed}" if kept is None else f"undecided, {kept} to {failed}"


def threshold(points: Sequence[tuple[float, Value]]) -> Threshold:
    """Return the threshold of a dial from the shares in % by strength, the weakest first."""
    kept = [*takewhile(lambda each: _keeps(each[1]), points)]
    failed = [*takewhile(lambda each: fails(each[1]), reversed(points))]
    return Threshold(
        kept[-1][0] if kept else None,
        failed[-1][0] if failed else None,
        decided=len(kept) + len(failed) == len(points),
    )


def _keeps(share: Value) -> bool:
    return share.low is not None and share.low >= 100 * KEPT


def fails(share: Value) -> bool:
    """Return True if the whole interval of a share in % lies under 95 %."""
    return share.high is not None and share.high < 100 * KEPT
