"""95 % confidence intervals of proportions, means and medians over the runs of a study."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]


class Interval(NamedTuple):
    """Ends of a 95 % confidence interval; `UNBOUNDED` if there are too few runs."""

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


_FEWEST = 6
"""Number of runs below which there is no 95 % interval: the smallest and the largest of n values
enclose their median with a probability of 1 - 2 / 2^n."""

_RESAMPLES = 399  # number of resamples of a bootstrap
UNBOUNDED = Interval(-np.inf, np.inf)  # interval of a figure of which too few runs tell anything


def run_interval(
    runs: Sequence[Floats] | Floats, statistic: Callable[[Floats], float] = np.mean
) -> Interval:
    """Return the bootstrap interval of a statistic of runs: of (n,) values, or all volumes of each.

    Whole runs are resampled, as the volumes of one resemble each other, always in the same way.
    Values may be infinite; unknown ones (NaN) leave the interval unknown, as the statistic. Fewer
    than six runs leave it unbounded.
    """
    if len(runs) < _FEWEST:
        return UNBOUNDED

    def figure(numbers: NDArray[np.int64]) -> float:
        return statistic(np.concatenate([np.atleast_1d(runs[number]) for number in numbers]))

    draws = np.random.default_rng(0).integers(0, len(runs), (_RESAMPLES, len(runs)))
    with np.errstate(invalid="ignore"):  # values may be infinite
        low, high = np.quantile([*map(figure, draws)], (0.025, 0.975), method="inverted_cdf")
    return Interval(float(low), float(high))


def count_interval(count: int) -> Interval:
    """Return the exact interval of the expected number of rare events, of which some were seen."""
    low = squared_distance(0.025, 2 * count) / 2 if count else 0.0
    return Interval(low, squared_distance(0.975, 2 * count + 2) / 2)
