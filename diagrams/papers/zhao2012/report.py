"""Report of the reproduction of Zhao 2012: rows beside the paper's figures and the targets."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.loop_report import loop_rows
from sonoservo.diagrams.papers.zhao2012.notes_report import NAMES, NOTES, TITLE
from sonoservo.diagrams.papers.zhao2012.plots import plot_rmse, plot_speeds
from sonoservo.diagrams.papers.zhao2012.rmse_analysis import Errors, tracking_errors
from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES
from sonoservo.diagrams.papers.zhao2012.speed_report import speed_errors, speed_rows
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow
from sonoservo.systems.evaluation.intervals import Interval, run_interval

TABLE_2 = {"static": (58, 68, 40, 40, 36, 40), "dynamic": (37, 36, 30, 24, 30, 30)}
"""Published mean improvement of RANSAC and Kalman over RANSAC for the `QUANTITIES`, in percent."""

LONG = 15
"""Length in mm from which on the absolute errors have targets."""

_UNITS = dict(zip(QUANTITIES, ("deg", "deg", "mm", "mm", "mm", "mm"), strict=True))
_KINDS = ("fresh speckle", "same volumes")


def report(outcomes: Sequence[Outcome], logs: Path | None = None) -> Study:
    """Return the study of finished runs.

    Parameters
    ----------
    outcomes
        Outcomes of all experiments.
    logs
        Folder of the runs; without it, there are no figures.
    """
    rows: list[StudyRow] = []
    figures = []
    names = dict.fromkeys(each.case.experiment for each in outcomes)
    dynamic = [name for name in names if name.startswith("dynamic")]
    for name in [f"static, {kind}" for kind in _KINDS if f"static, {kind}" in names] + dynamic:
        errors = tracking_errors(outcomes, name)
        if errors is None:
            continue
        published = name.endswith(_KINDS)
        rows += _reductions(name, errors, published) + _absolutes(name, errors)
        if published and logs:
            figures += plot_rmse(name, errors.lengths, errors.rmse(), NAMES)
    speeds = {name: speed_errors(outcomes, name) for name in dynamic}
    for name, found in speeds.items():
        rows += speed_rows(name, found)
    if logs and any(speeds.values()):
        figures.append(plot_speeds(speeds))
    rows += _kept_voxel_rows(outcomes) + loop_rows(outcomes)
    seconds = [s for each in outcomes for s in each.result.get("seconds", [])]
    return Study(
        paper="zhao2012",
        title=TITLE,
        rows=rows,
        outcomes=outcomes,
        figures=figures,
        compute_ms={
            "from radio-frequency lines to the estimate": {
                "median": 1e3 * float(np.median(seconds)) if seconds else None,
                "max": 1e3 * max(seconds) if seconds else None,
            }
        },
        notes=NOTES,
    )


def _over_runs(errors: Errors, figure: Callable[[NDArray[Any]], float]) -> tuple[float, Interval]:
    """Return a figure of all runs, and its interval."""
    every = np.arange(errors.runs)
    return figure(every), run_interval(list(every[:, np.newaxis]), figure)


def _reductions(experiment: str, errors: Errors, published: bool) -> list[StudyRow]:
    """Return the rows that compare with Table 2: by how much a filter's errors are smaller."""
    paper = TABLE_2[experiment.split(",")[0]] if published else 6 * (None,)
    rows = []
    for number, quantity in enumerate(QUANTITIES):
        for base in ("ransac", "ransac_sample", "ours") if published else ("ransac",):

            def reduction(runs: NDArray[Any], of: str, base: str = base, q: int = number) -> float:
                mean = errors.mean_rmse(runs)
                return float(100 * (1 - mean[_at(of), q] / mean[_at(base), q]))

            ours, (low, high) = _over_runs(errors, lambda r, f=reduction: f(r, "kalman_velocity"))  # type: ignore[misc]
            theirs, bounds = _over_runs(errors, lambda r, f=reduction: f(r, "published"))  # type: ignore[misc]
            shown = base != "ours"
            figure = paper[number] if shown else None
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=f"{quantity}: RMSE less than with {NAMES[base]}",
                    unit="%",
                    paper=figure,
                    true=ours,
                    low=low,
                    high=high,
                    published_true=theirs if shown else None,
                    published_low=bounds.low if shown else None,
                    published_high=bounds.high if shown else None,
                    target=(figure or 0) if published else None,
                    wanted="at least",
                )
            )
    return rows


def _at(estimator: str) -> int:
    return ESTIMATORS.index(estimator)


def _absolutes(experiment: str, errors: Errors) -> list[StudyRow]:
    """Return the rows of the absolute errors, and of the volumes in which nothing was found."""
    rows = []
    for estimator in ESTIMATORS:
        for number, quantity in enumerate(QUANTITIES):

            def mean(runs: NDArray[Any], e: int = _at(estimator), q: int = number) -> float:
                return float(errors.mean_rmse(runs)[e, q])

            value, interval = _over_runs(errors, mean)
            rows.append(
                _row(
                    experiment,
                    f"{quantity}: RMSE, {NAMES[estimator]}",
                    _UNITS[quantity],
                    estimator == "published",
                    value,
                    interval,
                )
            )
    for estimator, share in zip(ESTIMATORS, errors.missing, strict=True):
        filtered = estimator.startswith("kalman")
        rows.append(
            _row(
                experiment,
                f"nothing found, {NAMES[estimator]}",
                "%",
                estimator == "published",
                100 * float(share),
                target=0 if filtered else None,
            )
        )
    if experiment.endswith("fresh speckle"):
        long = errors.rmse()[errors.lengths >= LONG]
        for quantity, most in (("alpha", 0.6), ("beta", 0.6), ("tip", 0.5)):
            worst = long[:, :, QUANTITIES.index(quantity)].max(axis=0)
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=f"{quantity}: largest RMSE from {LONG} mm on",
                    unit=_UNITS[quantity],
                    true=float(worst[_at("kalman_velocity")]),
                    published_true=float(worst[_at("published")]),
                    target=most,
                )
            )
    return rows


def _row(
    experiment: str,
    quantity: str,
    unit: str,
    published: bool,
    value: float | None,
    interval: Interval | None = None,
    target: float | None = None,
) -> StudyRow:
    """Return a row with a figure of our method, or of the published one."""
    low, high = interval or (None, None)
    own: dict[str, Any] = {"true": value, "low": low, "high": high}
    if published:
        own = {f"published_{name}": each for name, each in own.items()}
    return StudyRow(experiment=experiment, quantity=quantity, unit=unit, target=target, **own)


def _kept_voxel_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the median error of the published RANSAC's tip by the number of kept voxels."""
    rows = []
    names = dict.fromkeys(each.case.experiment for each in outcomes)
    for name in (each for each in names if each.startswith("kept voxels")):
        mine = [each for each in outcomes if each.case.experiment == name]
        for number, kept in enumerate(mine[0].case.settings["kept_mm3"]):
            # A run that failed found nothing.
            tips = [each.result["tip_mm"][number] if each else None for each in mine]
            values = np.array([np.inf if tip is None else tip for tip in tips], dtype=float)
            interval = run_interval(list(values[:, np.newaxis]), _median)
            quantity = f"tip error of RANSAC, {kept} mm3 kept, median"
            rows.append(_row(name, quantity, "mm", True, _median(values), interval))
    return rows


def _median(values: NDArray[np.float64]) -> float:
    return float(np.quantile(values, 0.5, method="inverted_cdf"))
