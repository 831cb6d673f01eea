"""Rows of the speed of the tip: of the velocimeter inside the tracker, and of other sources."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.papers.zhao2012.runs import SPEEDOMETERS
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
