"""Report of the reproduction of Zhao 2012: rows beside the paper's figures and the targets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.plots import plot_rmse, plot_speeds
from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES
from sonoservo.diagrams.papers.zhao2012.speed_report import loop_rows, speed_errors, speed_rows
from sonoservo.diagrams.studies.run_group import Value, pooled, quantile_of
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import Study, StudyRow, read_notes
from sonoservo.systems.evaluation.intervals import run_interval

TITLE = (
    "Zhao, Liebgott and Cachard, Tracking biopsy needle using Kalman filter and RANSAC algorithm "
    "with 3D ultrasound (Acoustics 2012)"
)

NAMES = {
    "ransac_sample": "RANSAC, best sample",
    "ransac": "RANSAC",
    "published": "published RANSAC + Kalman + velocity",
    "ours": "our RANSAC",
    "kalman": "RANSAC + Kalman",
    "kalman_velocity": "RANSAC + Kalman + velocity",
}
"""Name of each estimator."""


TABLE_2 = {"static": (58, 68, 40, 40, 36, 40), "dynamic": (37, 36, 30, 24, 30, 30)}
"""Published mean improvement of RANSAC and Kalman over RANSAC for the `QUANTITIES`, in percent."""

LONG = 15
"""Length in mm above which the absolute errors have targets."""

_UNITS = dict(zip(QUANTITIES, ("deg", "deg", "mm", "mm", "mm", "mm"), strict=True))
_KINDS = ("fresh speckle", "same volumes")


_ACTIVE = 2
"""Number of volumes before the filter works; until then the paper's returns RANSAC's result."""


@dataclass(frozen=True)
class Errors:
    """Errors of an experiment, at (m,) lengths of the needle in mm.

    `squared`: (runs, m, estimators, quantities) mean squared errors of a run; an estimator that
    found nothing has the worst of the other runs, and so has a failed run. `missing`: (estimators,)
    shares of the volumes in which nothing was found.
    """

    lengths: NDArray[np.float64]
    squared: NDArray[np.float64]
    missing: NDArray[np.float64]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.squared)

    def rmse(self, runs: NDArray[Any] | slice = slice(None)) -> NDArray[np.float64]:
        """Return (m, estimators, quantities) root mean square errors over some or all runs."""
        return np.asarray(np.sqrt(self.squared[runs].mean(axis=0)))

    def mean_rmse(self, runs: NDArray[Any] | slice = slice(None)) -> NDArray[np.float64]:
        """Return (estimators, quantities) means of these errors over the lengths."""
        return np.asarray(self.rmse(runs).mean(axis=0))


def tracking_errors(outcomes: Sequence[Outcome], experiment: str) -> Errors | None:
    """Return the errors of an experiment from the third volume on; None without finished runs."""
    mine = [each for each in outcomes if each.case.experiment == experiment]
    finished = [each for each in mine if each]
    if not finished:
        return None
    errors = np.array([each.result["errors"] for each in finished], dtype=float)
    if experiment.startswith("dynamic"):
        settings = finished[0].case.settings
        steps = settings["interval_s"] * np.array([0.0, *settings["speeds_mm_s"]])
        lengths = 5 + np.cumsum(steps)[_ACTIVE:]
        errors = errors[:, np.newaxis, _ACTIVE:]
    else:
        lengths = np.array(finished[0].case.settings["lengths_mm"], dtype=float)
        # The volumes of one length show the same; all of them count.
        errors = np.moveaxis(errors[:, :, _ACTIVE:], 2, 1)
    missing = np.isnan(errors[..., 0])
    squared = np.where(np.isnan(errors), -np.inf, errors**2)
    worst = squared.max(axis=(0, 1))
    squared = np.where(np.isfinite(squared), squared, worst).mean(axis=1)
    lost = len(mine) - len(finished)
    squared = np.concatenate([squared, np.repeat(worst[np.newaxis], lost, axis=0)])
    squared = np.where(np.isfinite(squared), squared, np.nan)  # nobody found anything
    return Errors(lengths, squared, missing.mean(axis=(0, 1, 2)))


def report(outcomes: Sequence[Outcome], folder: Path | None = None) -> Study:
    """Return the study of finished runs; without its folder, there are no figures."""
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
        if published and folder:
            figures += plot_rmse(name, errors.lengths, errors.rmse(), NAMES)
    speeds = {name: speed_errors(outcomes, name) for name in dynamic}
    for name, found in speeds.items():
        rows += speed_rows(name, found)
    if folder and any(speeds.values()):
        figures.append(plot_speeds(speeds))
    rows += _kept_voxel_rows(outcomes) + _open_value_rows(outcomes) + loop_rows(outcomes)
    seconds = [s for each in outcomes for s in each.result.get("compute_s", [])]
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
        notes=read_notes("sonoservo.diagrams.papers.zhao2012"),
    )


def _over_runs(errors: Errors, figure: Callable[[NDArray[Any]], float]) -> Value:
    """Return a figure of all runs, given their numbers, with its interval."""
    every = np.arange(errors.runs)
    return Value(figure(every), None, *run_interval(list(every[:, np.newaxis]), figure))


def _reductions(experiment: str, errors: Errors, published: bool) -> list[StudyRow]:
    """Return the rows that compare with Table 2: by how much a filter's errors are smaller."""
    paper = TABLE_2[experiment.split(",")[0]] if published else 6 * (None,)

    def reduction(of: str, base: str, q: int) -> Value:
        def figure(runs: NDArray[Any]) -> float:
            mean = errors.mean_rmse(runs)
            return float(100 * (1 - mean[_at(of), q] / mean[_at(base), q]))

        return _over_runs(errors, figure)

    rows = []
    for q, quantity in enumerate(QUANTITIES):
        for base in ("ransac", "ransac_sample", "ours") if published else ("ransac",):
            known = paper[q] if base != "ours" else None
            rows.append(
                StudyRow.of(
                    experiment,
                    f"{quantity}: RMSE less than with {NAMES[base]}",
                    "%",
                    reduction("kalman_velocity", base, q),
                    reduction("published", base, q) if base != "ours" else None,
                    paper=known,
                    target=(known or 0) if published else None,
                    wanted="at least",
                )
            )
    return rows


def _at(estimator: str) -> int:
    return ESTIMATORS.index(estimator)


def _absolutes(experiment: str, errors: Errors) -> list[StudyRow]:
    """Return the rows of the absolute errors, and of the volumes in which nothing was found."""
    rows = []
    for e, estimator in enumerate(ESTIMATORS):
        for q, quantity in enumerate(QUANTITIES):
            mean = _over_runs(errors, lambda runs, e=e, q=q: float(errors.mean_rmse(runs)[e, q]))  # type: ignore[misc]
            name = f"{quantity}: RMSE, {NAMES[estimator]}"
            rows.append(_row(experiment, name, _UNITS[quantity], estimator, mean))
    for estimator, share in zip(ESTIMATORS, errors.missing, strict=True):
        name = f"nothing found, {NAMES[estimator]}"
        target = 0 if estimator.startswith("kalman") else None
        found = Value(100 * float(share))
        rows.append(_row(experiment, name, "%", estimator, found, target=target))
    if experiment.endswith("fresh speckle") and errors.lengths[-1] >= LONG:
        worst = errors.rmse()[errors.lengths >= LONG].max(axis=0)
        for quantity, most in (("alpha", 0.6), ("beta", 0.6), ("tip", 0.5)):
            ours, published = (
                Value(float(worst[_at(each), QUANTITIES.index(quantity)]))
                for each in ("kalman_velocity", "published")
            )
            name = f"{quantity}: largest RMSE from {LONG} mm on"
            unit = _UNITS[quantity]
            rows.append(StudyRow.of(experiment, name, unit, ours, published, target=most))
    return rows


def _row(
    experiment: str, quantity: str, unit: str, estimator: str, value: Value, **more: Any
) -> StudyRow:
    """Return a row with a figure of one of our estimators, or of the published one."""
    both = (Value(), value) if estimator == "published" else (value,)
    return StudyRow.of(experiment, quantity, unit, *both, **more)


def _kept_voxel_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the median error of the published RANSAC's tip by the number of kept voxels."""
    rows = []
    names = dict.fromkeys(each.case.experiment for each in outcomes)
    for name in (each for each in names if each.startswith("kept voxels")):
        mine = [each for each in outcomes if each.case.experiment == name]
        for number, kept in enumerate(mine[0].case.settings["kept_mm3"]):
            # A run that failed found nothing.
            tips = [each.result["tip_mm"][number] if each else None for each in mine]
            runs = [np.array([np.inf if tip is None else tip]) for tip in tips]
            quantity = f"tip error of RANSAC, {kept} mm3 kept, median"
            rows.append(_row(name, quantity, "mm", "published", pooled(runs, quantile_of(0.5))))
    return rows


def _open_value_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return by how much the published filter's tip is better than RANSAC's with each noise."""
    name = "open values"
    tips = [each.result["tip_mm"] for each in outcomes if each and each.case.experiment == name]
    rows = []
    for noise in (each for each in (tips[0] if tips else ()) if each != "RANSAC"):
        # (volumes, 2) squared errors of a run, of RANSAC and with this noise.
        runs = [
            np.array([each["RANSAC"][_ACTIVE:], each[noise][_ACTIVE:]], dtype=float).T ** 2
            for each in tips
        ]
        quantity = f"tip: RMSE less than with RANSAC, {noise}"
        rows.append(_row(name, quantity, "%", "published", pooled(runs, _gain)))
    return rows


def _gain(squares: NDArray[np.float64]) -> float:
    """Return by how much the second column's root mean square is below the first's, in %."""
    ransac, filtered = np.nanmean(squares, axis=0)
    return 100 * (1 - float(np.sqrt(filtered / ransac)))
