"""Rows of the speed of the tip, from single volumes and in the loop of Chatelain 2013's fig. 5."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.runs import SPEEDOMETERS
from sonoservo.diagrams.studies.following.analysis import Run
from sonoservo.diagrams.studies.following.method_report import (
    Comparison,
    MethodRuns,
    add_rest_rows,
    add_tracking_rows,
)
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import StudyRow
from sonoservo.systems.evaluation.intervals import run_interval

SPEEDOMETER_NAMES = {
    "velocimeter": "velocimeter in our tracker",
    "differenced": "difference of RANSAC's tips",
    "without": "our filter without velocimeter",
    "with": "our filter with velocimeter",
    "published": "published filter",
}

_RMSE_TARGET = 0.3


def speed_errors(
    outcomes: Sequence[Outcome], experiment: str
) -> Mapping[str, list[NDArray[np.float64]]]:
    """Return the errors of the speed along the needle in mm/s by source and run.

    They count from the third volume on; NaN where a source gave nothing. The true speed is the mean
    between two volumes.
    """
    mine = [each for each in outcomes if each and each.case.experiment == experiment]
    errors: dict[str, list[NDArray[np.float64]]] = {}
    for each in mine:
        found = np.array(each.result["speeds_mm_s"], dtype=float)
        true = np.array([0.0, *each.case.settings["speeds_mm_s"]])
        for name, column in zip(SPEEDOMETERS, (found - true[:, np.newaxis])[2:].T, strict=True):
            errors.setdefault(name, []).append(column)
    return errors


def speed_rows(experiment: str, errors: Mapping[str, list[NDArray[np.float64]]]) -> list[StudyRow]:
    """Return rows with bias, RMSE and share of the volumes with a speed of each source."""
    rows = []
    published = experiment.endswith("fresh speckle")
    for name, runs in errors.items():
        label = SPEEDOMETER_NAMES[name]
        target = _RMSE_TARGET if published and name == "velocimeter" else None
        for quantity, figure, most in (("bias", bias, None), ("RMSE", rmse, target)):
            value = figure(np.concatenate(runs))
            low, high = run_interval(runs, figure)
            values: dict[str, Any] = {"true": value, "low": low, "high": high}
            if np.isnan(value):
                values = {}
            if name == "published":
                values = {f"published_{key}": each for key, each in values.items()}
            rows.append(
                StudyRow(
                    experiment=experiment,
                    quantity=f"speed along the needle, {quantity}, {label}",
                    unit="mm/s",
                    target=most,
                    **values,
                )
            )
        if name == "velocimeter":
            share = 100 * float(np.mean(np.isfinite(np.concatenate(runs))))
            quantity = f"speed found, {label}"
            rows.append(StudyRow(experiment=experiment, quantity=quantity, unit="%", true=share))
    return rows


def bias(errors: NDArray[np.float64]) -> float:
    """Return the mean of the known errors; NaN without any."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if len(known) else np.nan


def rmse(errors: NDArray[np.float64]) -> float:
    """Return the root mean square of the known errors; NaN without any."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt((known**2).mean())) if len(known) else np.nan


Floats = NDArray[np.float64]

CLOSED_LOOP = "closed loop"
"""Name of the experiment with fig. 5 as it is."""

NO_VELOCIMETER = ", without velocimeter"
INTERACTING = ", interacting filter"
"""Endings of the names of the experiments with our trackers that have no velocimeter."""

_BASELINES = {
    NO_VELOCIMETER: "the same filter without velocimeter",
    INTERACTING: "our interacting filter",
}

WITHIN = 0.5
"""Largest bias of the speed that is aimed at, in mm/s."""

_JUDGED = 10.0
"""Largest speed at which it is aimed at, in mm/s."""

_SETTLED = 1.0
"""Time in s after the beginning of a push from which on its speed counts."""


def loop_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of the runs in the loop, of the outcomes of all experiments."""
    names = list(dict.fromkeys(each.case.experiment for each in outcomes))
    rows: list[StudyRow] = []
    if CLOSED_LOOP in names:
        group = Comparison(outcomes, CLOSED_LOOP)
        add_rest_rows(group)
        add_tracking_rows(group)
        rows += group.rows
    for name in (each for each in names if each + NO_VELOCIMETER in names):
        rows += _speed_rows(outcomes, name)
    return rows


def _speed_rows(outcomes: Sequence[Outcome], name: str) -> list[StudyRow]:
    """Return bias and root mean square error of the estimated speed at each true speed."""
    group = Comparison(outcomes, name)
    ours, published = (
        [loop_errors(run) for run in each.runs] for each in (group.ours, group.published)
    )
    baselines = {
        label: [loop_errors(run) for run in MethodRuns(outcomes, name + ending).runs]
        for ending, label in _BASELINES.items()
    }
    rows = []
    for speed in sorted({each for run in (*ours, *published) for each in run}):
        when = f"at {speed:g} mm/s, while tracked, from {_SETTLED:g} s after a change on"
        for what, figure in (("bias", bias), ("RMSE", rmse)):
            quantity = f"speed along the needle, {what} {when}"
            values = _values(ours, speed, figure) | _values(published, speed, figure, "published_")
            rows.append(StudyRow(experiment=name, quantity=quantity, unit="mm/s", **values))
            rows += [
                StudyRow(
                    experiment=name,
                    quantity=f"{quantity}, {label}",
                    unit="mm/s",
                    **_values(baseline, speed, figure),
                )
                for label, baseline in baselines.items()
                if baseline
            ]
        quantity = f"volumes not tracked at {speed:g} mm/s, from {_SETTLED:g} s after a change on"
        values = _values(ours, speed, _missing) | _values(published, speed, _missing, "published_")
        rows.append(StudyRow(experiment=name, quantity=quantity, unit="%", **values))
        if speed <= _JUDGED:
            size = _values(ours, speed, bias)["true"]
            rows.append(
                StudyRow(
                    experiment=name,
                    quantity=f"speed along the needle, size of the bias {when}",
                    unit="mm/s",
                    true=None if size is None else abs(size),
                    target=WITHIN,
                )
            )
    return rows


def _missing(errors: Floats) -> float:
    return 100 * float(np.isnan(errors).mean())


def _values(
    runs: Sequence[Mapping[float, Floats]],
    speed: float,
    figure: Callable[[Floats], float],
    prefix: str = "",
) -> dict[str, Any]:
    """Return a figure of the errors at one speed and its interval, as fields of a row."""
    errors = [run[speed] for run in runs if len(run.get(speed, ()))]
    if not errors:
        return {f"{prefix}true": None}
    low, high = run_interval(errors, figure)
    true = figure(np.concatenate(errors))
    if np.isnan(true):
        return {f"{prefix}true": None}
    return {f"{prefix}true": true, f"{prefix}low": low, f"{prefix}high": high}


def loop_errors(run: Run) -> dict[float, Floats]:
    """Return the errors of the estimated speed along the needle in mm/s, by true speed in mm/s.

    Volumes count from `_SETTLED` after the beginning of a push on, NaN if not tracked. The first
    push, during which the needle is found, does not count.
    """
    hand, volumes = run.scenario.hand, run.volumes
    assert hand.start is not None
    time = volumes.time
    along = np.where(volumes.tracked, 1e3 * volumes.along, np.nan)
    begin = hand.start + hand.pushes[0].duration
    errors: dict[float, Floats] = {}
    for push in hand.pushes[1:]:
        end = begin + push.duration
        speed = round(1e3 * push.speed, 3)
        found = along[(time >= begin + _SETTLED) & (time <= end)] - speed
        errors[speed] = np.concatenate([errors.get(speed, np.zeros(0)), found])
        begin = end
    return errors
