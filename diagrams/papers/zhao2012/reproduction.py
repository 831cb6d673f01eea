"""Reproduction of Zhao, Liebgott and Cachard (Acoustics 2012), and their tracker in a closed loop.

>>> sonoservo reproduce zhao2012 --quick
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.phantom import DIRECTION
from sonoservo.diagrams.papers.zhao2012.plots import plot_rmse, plot_velocimeter
from sonoservo.diagrams.papers.zhao2012.runs import ESTIMATORS, QUANTITIES, VOLUMES, run_case
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case, Outcome, StudyOptions
from sonoservo.diagrams.studies.study_report import Study, StudyRow

TITLE = (
    "Zhao, Liebgott and Cachard, Tracking biopsy needle using Kalman filter and RANSAC algorithm "
    "with 3D ultrasound (Acoustics 2012)"
)

TABLE_2 = {"static": (58, 68, 40, 40, 36, 40), "dynamic": (37, 36, 30, 24, 30, 30)}
"""Published mean improvement of RANSAC and Kalman over RANSAC for the `QUANTITIES`, in percent."""

SPEEDS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0)
"""True speeds in the velocimeter's trial, in mm/s."""

LONG = 15
"""Length in mm from which on the absolute errors have targets."""

NOTES = (
    "'RANSAC' is the published method. Among the brightest voxels of the whole volume, it finds "
    "the line through two of them with the most others nearby, optimizes it on those, and places "
    "the tip where the intensity along the line falls. Its best sample alone is shown too. 'Our "
    "RANSAC' is the one in the tracker: it searches near the prediction and refits three times. "
    "The Kalman filter uses our RANSAC.",
    "Fresh speckle: each run has a phantom of its own. Same volumes: all runs share one phantom "
    "and differ only in RANSAC's draws, as probably in the paper. A needle at rest is shown 8 "
    "times, unchanged.",
    "Errors count from the third volume on; before, the paper's filter returns RANSAC's result. A "
    "reduction compares the means, over lengths or volumes, of the root mean square over runs.",
    "The paper does not publish the noise of the filter, the thresholds, the definition of the "
    "angles or the position of the needle. Here, alpha is the azimuth from the array towards "
    "elevation, and beta the angle from the depth. The velocimeter compares envelopes in the "
    "published windows, centred on the predicted displacement.",
)

_NAMES = {
    "ransac_sample": "RANSAC, best sample",
    "ransac": "RANSAC",
    "ours": "our RANSAC",
    "kalman": "RANSAC + Kalman",
    "kalman_velocity": "RANSAC + Kalman + velocity",
}
_UNITS = dict(zip(QUANTITIES, ("deg", "deg", "mm", "mm", "mm", "mm"), strict=True))


def reproduce(options: StudyOptions) -> Study:
    """Run the experiments, and compare them with the paper."""
    outcomes = run_cases(
        run_case,
        _cases(options),
        options.folder / "cases",
        jobs=options.jobs,
        cluster=options.cluster,
        console=options.console,
    )
    errors = {name: _errors(outcomes, name) for name in _tracking_experiments()}
    rows = [row for name, found in errors.items() for row in _tracking_rows(name, found)]
    rows += _velocity_rows(outcomes) + _closed_loop_rows(outcomes)
    figures = []
    for name, found in errors.items():
        if found is not None:
            figures += plot_rmse(name, found.lengths, found.rmse, _NAMES)
    trial = _velocimeter_trial(outcomes)
    if len(trial):
        figures.append(plot_velocimeter(np.array(SPEEDS), trial))
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


def _tracking_experiments() -> list[str]:
    kinds = ("fresh speckle", "same volumes")
    return [f"{motion}, {kind}" for motion in ("static", "dynamic") for kind in kinds]


def _cases(options: StudyOptions) -> list[Case]:
    lengths = [5, 10, 15, 20] if options.quick else [5, 6, 7, 9, 11, 13, 15, 17, 20]
    settings: dict[str, dict[str, Any]] = {
        "static": {"lengths_mm": lengths, "volumes": 8},
        "dynamic": {"volumes": VOLUMES},
    }
    seeds = options.seed_range(50, 2)
    cases = []
    for seed in seeds:
        for name in _tracking_experiments():
            motion, kind = name.split(", ")
            phantom = seed if kind == "fresh speckle" else options.first_seed
            cases.append(Case(name, seed, {**settings[motion], "phantom": phantom}))
        cases.append(Case("velocimeter", seed, {"phantom": seed, "speeds_mm_s": list(SPEEDS)}))
    for tracker in ("chatelain2013", "zhao2012"):
        for seed in options.seed_range(10, 1):
            changes = [f"tracker={tracker}"]
            scenario = {"scenario": "chatelain2013_fig5", "changes": changes}
            cases.append(Case(f"closed loop, {tracker}", seed, scenario))
    return cases


@dataclass(frozen=True)
class _Errors:
    """Errors of an experiment over its runs.

    Parameters
    ----------
    lengths
        (m,) lengths of the needle, in mm.
    rmse
        (m, estimators, quantities) root mean square errors over runs; NaN if no run found a needle.
    missing
        (estimators,) shares of the volumes in which nothing was found, from 0 to 1.
    """

    lengths: NDArray[np.floating[Any]]
    rmse: NDArray[np.floating[Any]]
    missing: NDArray[np.floating[Any]]


def _errors(outcomes: list[Outcome], experiment: str) -> _Errors | None:
    mine = [each for each in outcomes if each and each.case.experiment == experiment]
    if not mine:
        return None
    errors = np.array([each.result["errors"] for each in mine], dtype=float)
    if experiment.startswith("dynamic"):
        lengths = np.arange(5.0, 5.0 + VOLUMES)
    else:
        lengths = np.array(mine[0].case.settings["lengths_mm"], dtype=float)
        # Once the filter is active, the volumes of one length count as separate runs.
        errors = np.concatenate(np.moveaxis(errors[:, :, 2:], 2, 0))
    found = np.ma.masked_invalid(errors)
    rmse = np.sqrt((found**2).mean(axis=0)).filled(np.nan)
    return _Errors(lengths, rmse, np.isnan(errors[..., 0]).mean(axis=(0, 1)))


def _tracking_rows(experiment: str, errors: _Errors | None) -> list[StudyRow]:
    """Return the rows that compare with Table 2, and those of the absolute errors."""
    if errors is None:
        return []
    lengths, rmse = errors.lengths, errors.rmse
    motion = experiment.split(",")[0]
    if motion == "dynamic":
        lengths, rmse = lengths[2:], rmse[2:]
    mean = dict(zip(ESTIMATORS, np.nanmean(rmse, axis=0), strict=True))
    final = mean["kalman_velocity"]
    rows = []
    for number, quantity in enumerate(QUANTITIES):
        published = TABLE_2[motion][number]
        for estimator, paper in (
            ("ransac", published),
            ("ransac_sample", published),
            ("ours", None),
        ):
            reduction = 100 * (1 - final[number] / mean[estimator][number])
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=f"{quantity}: RMSE less than with {_NAMES[estimator]}",
                    unit="%",
                    paper=paper,
                    true=float(reduction),
                    target=paper or 0,
                    wanted="at least",
                )
            )
    for estimator, values in mean.items():
        for quantity, value in zip(QUANTITIES, values, strict=True):
            name = f"{quantity}: RMSE, {_NAMES[estimator]}"
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=name,
                    unit=_UNITS[quantity],
                    true=float(value),
                )
            )
    for estimator, share in zip(ESTIMATORS, errors.missing, strict=True):
        rows.append(
            StudyRow(
                experiment=experiment,
                quantity=f"nothing found, {_NAMES[estimator]}",
                unit="%",
                true=100 * float(share),
                target=0 if estimator.startswith("kalman") else None,
            )
        )
    long = rmse[lengths >= LONG, ESTIMATORS.index("kalman_velocity")].max(axis=0)
    if experiment.endswith("fresh speckle"):
        for quantity, most in (("alpha", 0.6), ("beta", 0.6), ("tip", 0.5)):
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=f"{quantity}: largest RMSE from {LONG} mm on",
                    unit=_UNITS[quantity],
                    true=float(long[QUANTITIES.index(quantity)]),
                    target=most,
                )
            )
    return rows


def _velocity_rows(outcomes: list[Outcome]) -> list[StudyRow]:
    """Return the rows of the velocimeter in the tracker, at 1 mm/s."""
    name = "dynamic, fresh speckle"
    found = [e.result["velocities_mm_s"] for e in outcomes if e and e.case.experiment == name]
    if not found:
        return []
    velocities = np.array(found, dtype=float)[:, 1:].reshape(-1, 3)
    known = ~np.isnan(velocities[:, 0])
    errors = velocities[known] - DIRECTION
    rows: list[tuple[str, str, float, float | None]]
    rows = [("found", "%", 100 * float(known.mean()), None)]
    if known.any():
        rows += [
            ("RMSE", "mm/s", float(np.sqrt((errors**2).sum(axis=1).mean())), 0.3),
            ("bias along the needle", "mm/s", float((errors @ DIRECTION).mean()), None),
        ]
    return [
        StudyRow(
            experiment="velocity at 1 mm/s", quantity=quantity, unit=unit, true=value, target=target
        )
        for quantity, unit, value, target in rows
    ]


def _velocimeter_trial(outcomes: list[Outcome]) -> NDArray[np.float64]:
    """Return (runs, speeds) measured speeds along the needle in mm/s; NaN if not measured."""
    mine = [each for each in outcomes if each and each.case.experiment == "velocimeter"]
    found = np.array([each.result["velocities_mm_s"] for each in mine], dtype=float)
    return found[..., :3] @ DIRECTION if len(found) else found


def _closed_loop_rows(outcomes: list[Outcome]) -> list[StudyRow]:
    """Return the rows of both trackers in Chatelain 2013's fig. 5, on the same seeds."""
    rows = []
    for tracker in ("chatelain2013", "zhao2012"):
        name = f"closed loop, {tracker}"
        mine = [each.result for each in outcomes if each and each.case.experiment == name]
        for quantity, unit, blocks, paper in (
            ("at rest, mean |X|", "mm", ("servo", "at_rest", "x_mm"), 1.10),
            ("at rest, mean |Z|", "mm", ("servo", "at_rest", "z_mm"), 0.23),
            ("at rest, mean |Theta|", "deg", ("servo", "at_rest", "theta_deg"), 0.97),
            ("tip error, median", "mm", ("tracking", "tip_error_mm", "median"), None),
            ("tip error, 95 %", "mm", ("tracking", "tip_error_mm", "p95"), None),
            ("axis error, median", "deg", ("tracking", "axis_error_deg", "median"), None),
            ("times lost, all runs", "", ("tracking", "lost_events"), None),
        ):
            values = [_value(each, blocks) for each in mine]
            known = [value for value in values if value is not None]
            combine = np.sum if quantity.startswith("times") else np.mean
            rows.append(
                StudyRow(
                    experiment=name,
                    quantity=quantity,
                    unit=unit,
                    paper=paper,
                    true=float(combine(known)) if known else None,
                    target=paper if tracker == "zhao2012" else None,
                )
            )
    return rows


def _value(result: object, keys: tuple[str, ...]) -> float | None:
    for key in keys:
        assert isinstance(result, dict)
        result = result[key]
    assert result is None or isinstance(result, (int, float))
    return result
