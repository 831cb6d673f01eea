"""95 % confidence intervals of proportions, means and medians over the runs of a study."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.requirements import require

_RESAMPLES = 2000
"""Number of resamples of a bootstrap, which fixes its ends to some per cent of its width."""


class Interval(NamedTuple):
    """Ends of a 95 % confidence interval; both are NaN if too little is known for one."""

    low: float
    high: float


def proportion_interval(successes: int, total: int) -> Interval:
    """Return the Wilson score interval of a proportion, from 0 to 1; all of it without runs."""
    require(0 <= successes <= total, "successes", successes, f"from 0 to {total}")
    if not total:
        return Interval(0.0, 1.0)
    from scipy.stats import binomtest  # slow to load, and wanted only where runs are pooled

    found = binomtest(int(successes), int(total)).proportion_ci(0.95, method="wilson")
    return Interval(float(found.low), float(found.high))


def bootstrap_interval(
    values: Sequence[float], statistic: Literal["mean", "median"] = "mean"
) -> Interval:
    """Return the bootstrap interval of the mean or the median of independent values.

    For a mean it is the bias-corrected and accelerated interval (Efron 1987). For a median, whose
    acceleration is undefined, it is the percentile interval. The resamples are the same in every
    call.

    Parameters
    ----------
    values
        One value for each run; NaN marks a run without one, which does not count.
    statistic
        Statistic of which the interval is computed.
    """
    known = np.asarray([value for value in values if np.isfinite(value)], dtype=float)
    if len(known) < 2:
        return Interval(np.nan, np.nan)
    if np.ptp(known) == 0:
        return Interval(float(known[0]), float(known[0]))
    from scipy.stats import bootstrap

    found = bootstrap(
        (known,),
        {"mean": np.mean, "median": np.median}[statistic],
        n_resamples=_RESAMPLES,
        method={"mean": "BCa", "median": "percentile"}[statistic],
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Interval(float(found.low), float(found.high))


_FEWEST = 6
"""Number of runs below which there is no 95 % interval: the smallest and the largest of n values
enclose their median with a probability of 1 - 2 / 2^n."""

_RESAMPLES = 399  # number of resamples of a bootstrap
UNBOUNDED = Interval(-np.inf, np.inf)  # interval of a figure of which too few runs tell anything


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
        from scipy.stats import bootstrap

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
    low = squared_distance(0.025, 2 * count) / 2 if count else 0.0
    return Interval(low, squared_distance(0.975, 2 * count + 2) / 2)
