"""Rows of a report about the errors of tracking, its failures, and what it says of itself."""

from functools import partial

import numpy as np

from sonoservo.diagrams.studies.following.analysis import Run
from sonoservo.diagrams.studies.following.method_report import Comparison, MethodRuns, Value

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
