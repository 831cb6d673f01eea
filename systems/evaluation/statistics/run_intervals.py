"""95 % confidence intervals of figures that pool many volumes of few runs, and of counts."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, chi2

from sonoservo.systems.evaluation.statistics.intervals import Interval

_FEWEST = 6
"""Number of runs below which there is no 95 % interval: the smallest and the largest of n values
enclose their median with a probability of 1 - 2 / 2^n."""

_RESAMPLES = 399
"""Number of resamples of a bootstrap."""

UNBOUNDED = Interval(-np.inf, np.inf)
"""Interval of a figure of which too few runs tell anything."""


def run_interval(
    runs: Sequence[NDArray[np.float64]], statistic: Callable[[NDArray[np.float64]], float]
) -> Interval:
    """Return the bootstrap interval of a statistic of all volumes of all runs.

    Whole runs are resampled, as the volumes of one run resemble each other. Values may be infinite.
    The resamples are the same in every call. Fewer than six runs leave the interval unbounded.
    """
    if len(runs) < _FEWEST:
        return UNBOUNDED

    def figure(numbers: NDArray[np.int64]) -> float:
        return statistic(np.concatenate([runs[number] for number in numbers]))

    return _bootstrapped(np.arange(len(runs)), figure, vectorized=False)


def mean_interval(values: NDArray[np.float64]) -> Interval:
    """Return the bootstrap interval of the mean of (n,) values, one a run; see `run_interval`."""
    return UNBOUNDED if len(values) < _FEWEST else _bootstrapped(values, np.mean, vectorized=True)


def _bootstrapped(values: NDArray[Any], figure: Callable[..., Any], vectorized: bool) -> Interval:
    with np.errstate(invalid="ignore"):  # values may be infinite
        found = bootstrap(
            (values,),
            figure,
            n_resamples=_RESAMPLES,
            vectorized=vectorized,
            method="percentile",
            rng=np.random.default_rng(0),
        )
    low, high = np.quantile(found.bootstrap_distribution, (0.025, 0.975), method="inverted_cdf")
    return Interval(float(low), float(high))


def count_interval(count: int) -> Interval:
    """Return the exact interval of the expected number of rare events, of which some were seen."""
    low = chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return Interval(float(low), float(chi2.ppf(0.975, 2 * count + 2) / 2))
