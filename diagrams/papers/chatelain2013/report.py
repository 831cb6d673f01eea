"""Report of the reproduction of Chatelain 2013: rows beside the paper's figures and the targets."""

from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from sonoservo.diagrams.papers.chatelain2013.analysis import (
    Run,
    converged,
    found_after,
    lag,
    pooled,
    quantile,
    recovery_times,
)
from sonoservo.diagrams.papers.chatelain2013.plots import study_figures
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow

TITLE = (
    "Chatelain, Krupa and Marchal, Real-time needle detection and tracking using a visually "
    "servoed 3D ultrasound probe (ICRA 2013)"
)
_NOTES = (
    "The paper shows one run of each experiment, on one phantom, and estimated errors only. Here, "
    "ground truth comes from the simulator; neither tracker nor controller reads it.",
    "Errors are those of the estimate after each volume, at the time for which it holds, pooled "
    "over all volumes of all runs with at least 20 mm of the needle in the image. A volume without "
    "an estimate counts as an infinite error, and a failed run as one more run of such volumes. "
    "Lost: the tracker searches although more than 15 mm are in the image.",
    "Converged: the needle is tracked, and its true |X| and |Z| are below 2 mm and |Theta| below "
    "2 deg throughout the last second of the run (bent: X and Z only). Back after a move of the "
    "phantom: the same for half a second, before the next move.",
    "Bent: fig. 5 with a needle of bevel radius 150 to 400 mm, bent to any side, 0 to 40 deg out "
    "of the horizontal, and a curve of order 3. The deviation is the largest distance between the "
    "true and the estimated curve in the image, in both directions, from the estimated entry on.",
    "Computing times are those of one thread while the study's other processes run.",
)
_MM, _DEG = 1e3, float(np.rad2deg(1))


class _Group:
    """Runs of one experiment, and the rows made from them."""

    def __init__(self, name: str, outcomes: Sequence[Outcome], logs: Path) -> None:
        self.name = name
        mine = [each for each in outcomes if each.case.experiment == name]
        self.runs = [Run(each, logs) for each in mine if each]
        self.failed = len(mine) - len(self.runs)
        self.rows: list[StudyRow] = []

    def __bool__(self) -> bool:
        return bool(self.runs) or self.failed > 0

    def row(self, quantity: str, unit: str = "", **values: Any) -> None:
        self.rows.append(StudyRow(experiment=self.name, quantity=quantity, unit=unit, **values))

    def each(self, *path: str) -> list[Any]:
        """Return a figure of every run's summary."""
        values = []
        for run in self.runs:
            node: Any = run.summary
            for key in path:
                node = node[key]
            values.append(node)
        return values

    def mean(self, *path: str) -> float | None:
        known = [value for value in self.each(*path) if value is not None]
        return float(np.mean(known)) if known else None

    def count(self, quantity: str, number: int, **values: Any) -> None:
        """Add a row with a number of runs; the more the better."""
        total = len(self.runs) + self.failed
        self.row(f"{quantity}, of {total}", true=number, wanted="at least", **values)

    def errors(self, name: str, quantity: str, unit: str, factor: float, **targets: float) -> None:
        """Add the rows of a pooled error: median, 95 % and largest."""
        values = factor * pooled(self.runs, self.failed, attrgetter(name))
        for what, q in (("median", 0.5), ("95 %", 0.95), ("largest", 1.0)):
            target = targets.get({"median": "median", "95 %": "p95"}.get(what, ""))
            self.row(f"{quantity}, {what}", unit, true=quantile(values, q), target=target)

    def reliability(self, target: float | None = None) -> None:
        """Add the rows of tracking failures."""
        untracked = pooled(self.runs, self.failed, lambda v: np.where(v.tracked, 0.0, 100.0))
        self.row("volumes not tracked", "%", true=_mean(np.minimum(untracked, 100)))
        lost = sum(np.sum(np.diff(run.volumes.lost.astype(int)) > 0) for run in self.runs)
        self.row("times lost, all runs", true=int(lost), target=target)
        self.false_starts(target)

    def false_starts(self, target: float | None = None) -> None:
        """Add the row of false starts."""
        starts = int(np.sum(self.each("detection", "false_starts")))
        self.row("false starts, all runs", true=starts, target=target)


def report(outcomes: Sequence[Outcome], logs: Path, ablations: Sequence[str]) -> Study:
    """Return the study of finished runs.

    Parameters
    ----------
    outcomes
        Outcomes of all experiments.
    logs
        Folder of their logs.
    ablations
        Names of the ablations, as in the experiments "fig5, NAME" and "fig6, NAME".
    """
    names = list(dict.fromkeys(each.case.experiment for each in outcomes))
    groups = {name: _Group(name, outcomes, logs) for name in names}
    for name, make_rows in (("fig4", _fig4), ("fig6", _fig6), ("bent", _bent)):
        if name in groups:
            make_rows(groups[name])
    if "fig5" in groups:
        _fig5(groups["fig5"], groups.get("fig5, no feed-forward"))
    _no_needle([group for name, group in groups.items() if name.startswith("no needle")])
    for name, group in groups.items():
        if name.removeprefix("fig5, ").removeprefix("fig6, ") in ablations:
            _ablation(group)
    return Study(
        paper="chatelain2013",
        title=TITLE,
        rows=[row for group in groups.values() for row in group.rows],
        outcomes=outcomes,
        figures=study_figures({name: group.runs for name, group in groups.items()}, ablations),
        compute_ms=_compute_ms(groups["fig4"].runs) if "fig4" in groups else {},
        notes=_NOTES,
    )


def _fig4(group: _Group) -> None:
    track = [1e3 * run.volumes.track_time for run in group.runs]
    times = np.concatenate(track) if track else np.zeros(0)
    group.row("tracking a volume, median", "ms", paper=175, true=quantile(times, 0.5), target=10)
    # A process loads or even compiles the kernels during its first volumes.
    group.row("tracking a volume, 99 %", "ms", paper=175, true=quantile(times, 0.99), target=175)
    found = [found_after(run.log) for run in group.runs]
    for k, which in enumerate(("first", "second")):
        lengths = [each[k] for each in found if len(each) > k] + group.failed * [(np.inf, np.inf)]
        for q, what in ((0.5, "median"), (1.0, "largest")):
            visible, inserted = (quantile([_MM * x[i] for x in lengths], q) for i in (0, 1))
            if visible is not None:
                target = 15 if what == "largest" else None
                group.row(
                    f"in the image when found, {which} insertion, {what}",
                    "mm",
                    true=visible,
                    target=target,
                )
                group.row(
                    f"in the tissue when found, {which} insertion, {what}", "mm", true=inserted
                )
    group.errors("tip", "tip error", "mm", _MM, median=0.7, p95=1.5)
    group.errors("axis", "axis error", "deg", _DEG, median=0.7, p95=1.5)
    group.reliability(target=0)


def _fig5(group: _Group, eq_25: _Group | None) -> None:
    for name, key, unit, paper, target in (
        ("X", "x_mm", "mm", 1.10, 0.6),
        ("Z", "z_mm", "mm", 0.23, 0.2),
        ("Theta", "theta_deg", "deg", 0.97, 0.6),
    ):
        group.row(
            f"at rest, mean |{name}|",
            unit,
            paper=paper,
            estimated=group.mean("servo", "at_rest_estimated", key),
            true=group.mean("servo", "at_rest", key),
            target=target,
        )
    total = len(group.runs) + group.failed
    group.count("converged", sum(converged(run.log) for run in group.runs), target=total)
    ours = _mean([_MM * lag(run.log, run.scenario) for run in group.runs])
    theirs = _mean([_MM * lag(run.log, run.scenario) for run in eq_25.runs]) if eq_25 else None
    group.row("lag in X while the hand moves at 5 mm/s", "mm", true=ours)
    group.row("the same by eq. 25 alone", "mm", true=theirs)
    ratio = theirs / ours if ours and theirs else None
    group.row("ratio of the two", true=ratio, target=4, wanted="at least")
    _force(group, 0.05)
    group.errors("tip", "tip error", "mm", _MM)
    group.errors("axis", "axis error", "deg", _DEG)
    group.reliability()


def _force(group: _Group, target: float | None = None) -> None:
    group.row("contact force, mean", "N", paper=2.0, true=group.mean("force", "mean_n"))
    worst = _largest(group.each("force", "rms_error_n"))
    group.row("contact force, RMS error, worst run", "N", true=worst, target=target)


def _fig6(group: _Group) -> None:
    _recovery(group, share=0.96, median=3.0)
    lost = _largest(group.each("force", "contact_lost_s"))
    group.row("contact lost, worst run", "s", true=lost, target=0.5)
    group.row("force, largest", "N", true=_largest(group.each("force", "max_n")), target=6)
    _force(group)
    group.errors("tip", "tip error", "mm", _MM)
    group.errors("axis", "axis error", "deg", _DEG)
    group.reliability()


def _recovery(group: _Group, share: float | None = None, median: float | None = None) -> None:
    """Add the rows of recovery after moves; targets: share of runs, and median time in s."""
    times = [recovery_times(run.log, run.scenario) for run in group.runs]
    total = len(group.runs) + group.failed
    back = sum(bool(np.isfinite(each).all()) for each in times)
    target = float(np.ceil(share * total)) if share else None
    group.count("runs back after every move", back, target=target)
    every = [time for each in times for time in each]
    moves = max(map(len, times), default=0)
    every += group.failed * moves * [np.inf]
    for q, what in ((0.5, "median"), (0.95, "95 %")):
        group.row(
            f"from the end of a move until back, {what}",
            "s",
            true=quantile(every, q),
            target=median if what == "median" else None,
        )


def _bent(group: _Group) -> None:
    group.errors("curve", "largest deviation along the curve", "mm", _MM, median=0.8, p95=1.5)
    group.errors("tip", "tip error", "mm", _MM)
    group.count("tip centred", sum(converged(run.log, straight=False) for run in group.runs))
    group.reliability()


def _no_needle(groups: Sequence[_Group]) -> None:
    for group in groups:
        group.row("volumes", true=sum(len(run.volumes.tip) for run in group.runs))
        group.false_starts(target=0)


def _ablation(group: _Group) -> None:
    if group.name.startswith("fig6"):
        _recovery(group)
    group.errors("tip", "tip error", "mm", _MM)
    group.errors("axis", "axis error", "deg", _DEG)
    group.reliability()
    group.rows = [row for row in group.rows if "largest" not in row.quantity]


def _compute_ms(runs: Sequence[Run]) -> dict[str, dict[str, float | None]]:
    """Return the median and largest times of rendering, conversion and tracking, in ms."""
    columns: dict[str, list[Any]] = {}
    for run in runs:
        for name, times in run.log.compute.items():
            columns.setdefault(name, []).append(1e3 * times)
    return {
        name: {
            "median": quantile(np.concatenate(times), 0.5),
            "max": quantile(np.concatenate(times), 1.0),
        }
        for name, times in columns.items()
    }


def _mean(values: Any) -> float | None:
    known = np.asarray(values, dtype=float)
    known = known[~np.isnan(known)]
    return float(known.mean()) if len(known) else None


def _largest(values: Sequence[float | None]) -> float | None:
    """Return the largest value; infinite if one is unknown, None if there are none."""
    if not values:
        return None
    return max(np.inf if value is None else value for value in values)
