"""Rows of the speed of the tip, from single volumes and in the loop of Chatelain 2013's fig. 5."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.runs import SPEEDOMETERS
from sonoservo.diagrams.studies.following.analysis import Run
from sonoservo.diagrams.studies.following.method_report import (
    ERRORS,
    Comparison,
    MethodRuns,
    at_rest,
    reliability,
)
from sonoservo.diagrams.studies.run_group import Value, pooled
from sonoservo.diagrams.studies.study import Outcome
from sonoservo.diagrams.studies.study_report import StudyRow

Floats = NDArray[np.float64]

SPEEDOMETER_NAMES = {
    "velocimeter": "velocimeter in our tracker",
    "differenced": "difference of RANSAC's tips",
    "without": "our filter without velocimeter",
    "with": "our filter with velocimeter",
    "published": "published filter",
}

_RMSE_TARGET = 0.3


def speed_errors(outcomes: Sequence[Outcome], experiment: str) -> Mapping[str, list[Floats]]:
    """Return errors of the speed in mm/s from the third volume on, by source and run."""
    mine = [each for each in outcomes if each and each.case.experiment == experiment]
    errors: dict[str, list[Floats]] = {}
    for each in mine:
        found = np.array(each.result["speeds_mm_s"], dtype=float)
        true = np.array([0.0, *each.case.settings["speeds_mm_s"]])
        for name, column in zip(SPEEDOMETERS, (found - true[:, np.newaxis])[2:].T, strict=True):
            errors.setdefault(name, []).append(column)
    return errors


def speed_rows(experiment: str, errors: Mapping[str, list[Floats]]) -> list[StudyRow]:
    """Return rows with bias, RMSE and share of the volumes with a speed of each source."""
    rows = []
    for name, runs in errors.items():
        judged = experiment.endswith("fresh speckle") and name == "velocimeter"
        for quantity, figure, target in (
            ("bias", bias, None),
            ("RMSE", rmse, _RMSE_TARGET if judged else None),
        ):
            value = _known(runs, figure)
            both = (Value(), value) if name == "published" else (value,)
            label = f"speed along the needle, {quantity}, {SPEEDOMETER_NAMES[name]}"
            rows.append(StudyRow.of(experiment, label, "mm/s", *both, target=target))
        if name == "velocimeter":
            share = Value(100 * float(np.mean(np.isfinite(np.concatenate(runs)))))
            label = f"speed found, {SPEEDOMETER_NAMES[name]}"
            rows.append(StudyRow.of(experiment, label, "%", share))
    return rows


def _known(runs: Sequence[Floats], figure: Callable[[Floats], float]) -> Value:
    """Return a figure of the errors of the runs that have any, with its interval."""
    return pooled([each for each in runs if np.isfinite(each).any()], figure)


def bias(errors: Floats) -> float:
    """Return the mean of the known errors; NaN without any."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if len(known) else np.nan


def rmse(errors: Floats) -> float:
    """Return the root mean square of the known errors; NaN without any."""
    known = errors[np.isfinite(errors)]
    return float(np.sqrt((known**2).mean())) if len(known) else np.nan


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
"""Time in s from the beginning of a push until its speed counts."""


def loop_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of the runs in the loop, of the outcomes of all experiments."""
    names = list(dict.fromkeys(each.case.experiment for each in outcomes))
    rows: list[StudyRow] = []
    if CLOSED_LOOP in names:
        group = Comparison(outcomes, CLOSED_LOOP)
        rows += group.rows((*at_rest(), *ERRORS, *reliability()))
    for name in (each for each in names if each + NO_VELOCIMETER in names):
        rows += _speed_rows(outcomes, name)
    return rows


def _speed_rows(outcomes: Sequence[Outcome], name: str) -> list[StudyRow]:
    """Return bias and root mean square error of the estimated speed at each true speed."""
    group = Comparison(outcomes, name)
    methods = {
        "": group.ours,
        "published": group.published,
        **{label: MethodRuns(outcomes, name + ending) for ending, label in _BASELINES.items()},
    }
    found = {label: [loop_errors(run) for run in each.runs] for label, each in methods.items()}
    rows = []

    def at(speed: float, label: str) -> list[Floats]:
        return [run[speed] for run in found[label] if len(run.get(speed, ()))]

    for speed in sorted(
        {each for label in ("", "published") for run in found[label] for each in run}
    ):
        when = f"at {speed:g} mm/s, while tracked, from {_SETTLED:g} s after a change on"
        for what, figure in (("bias", bias), ("RMSE", rmse)):
            quantity = f"speed along the needle, {what} {when}"
            both = (_known(at(speed, each), figure) for each in ("", "published"))
            rows.append(StudyRow.of(name, quantity, "mm/s", *both))
            rows += [
                StudyRow.of(name, f"{quantity}, {label}", "mm/s", _known(at(speed, label), figure))
                for label in _BASELINES.values()
                if found[label]
            ]
        quantity = f"volumes not tracked at {speed:g} mm/s, from {_SETTLED:g} s after a change on"
        both = (pooled(at(speed, each), _missing) for each in ("", "published"))
        rows.append(StudyRow.of(name, quantity, "%", *both))
        if speed <= _JUDGED:
            size = _known(at(speed, ""), bias).true
            quantity = f"speed along the needle, size of the bias {when}"
            value = Value(None if size is None else abs(size))
            rows.append(StudyRow.of(name, quantity, "mm/s", value, target=WITHIN))
    return rows


def _missing(errors: Floats) -> float:
    return 100 * float(np.isnan(errors).mean())


def loop_errors(run: Run) -> dict[float, Floats]:
    """Return the errors of the estimated speed along the needle in mm/s, by true speed in mm/s."""
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
