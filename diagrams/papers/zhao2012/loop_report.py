"""Rows of Zhao 2012's tracker in the loop of Chatelain 2013's fig. 5."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.speed_report import bias, rmse
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

Floats = NDArray[np.float64]

CLOSED_LOOP = "closed loop"
"""Name of the experiment with fig. 5 as it is."""

NO_VELOCIMETER = ", without velocimeter"
"""Ending of the name of an experiment with a tracker that has no velocimeter."""

WITHIN = 0.5
"""Largest bias of the speed that is aimed at, in mm/s."""

_JUDGED = 10.0
"""Largest speed at which it is aimed at, in mm/s."""

_SETTLED = 1.0
"""Time in s after the beginning of a push from which on its speed counts."""


def loop_rows(outcomes: Sequence[Outcome]) -> list[StudyRow]:
    """Return the rows of the runs in the loop.

    Parameters
    ----------
    outcomes
        Outcomes of all experiments.
    """
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
    without = MethodRuns(outcomes, name + NO_VELOCIMETER)
    ours, published, baseline = (
        [speed_errors(run) for run in each.runs] for each in (group.ours, group.published, without)
    )
    rows = []
    for speed in sorted({each for run in (*ours, *published, *baseline) for each in run}):
        when = f"at {speed:g} mm/s, while tracked, from {_SETTLED:g} s after a change on"
        for what, figure in (("bias", bias), ("RMSE", rmse)):
            quantity = f"speed along the needle, {what} {when}"
            values = _values(ours, speed, figure) | _values(published, speed, figure, "published_")
            rows.append(StudyRow(experiment=name, quantity=quantity, unit="mm/s", **values))
            quantity += ", our filter without velocimeter"
            values = _values(baseline, speed, figure)
            rows.append(StudyRow(experiment=name, quantity=quantity, unit="mm/s", **values))
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


def speed_errors(run: Run) -> dict[float, Floats]:
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
