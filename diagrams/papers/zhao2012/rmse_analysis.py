"""Root mean square errors of Zhao 2012's estimators over runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.diagrams.studies.study import Outcome

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
