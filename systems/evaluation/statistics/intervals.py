"""95 % confidence intervals of proportions, means and medians over the runs of a study."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.stats import binomtest, bootstrap

from sonoservo.systems.signals.requirements import require

_RESAMPLES = 2000
"""Number of resamples of a bootstrap, which fixes its ends to some per cent of its width."""


class Interval(NamedTuple):
    """Ends of a 95 % confidence interval; both are NaN if too little is known for one."""

    low: float
    high: float


def proportion_interval(successes: int, total: int) -> Interval:
    """Return the Wilson score interval of a proportion, from 0 to 1.

    Parameters
    ----------
    successes, total
        Number of successes, and of runs; without runs the interval is from 0 to 1.

    Raises
    ------
    ValueError
        If there are more successes than runs, or fewer than none.
    """
    require(0 <= successes <= total, "successes", successes, f"from 0 to {total}")
    if not total:
        return Interval(0.0, 1.0)
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
    found = bootstrap(
        (known,),
        {"mean": np.mean, "median": np.median}[statistic],
        n_resamples=_RESAMPLES,
        method={"mean": "BCa", "median": "percentile"}[statistic],
        rng=np.random.default_rng(0),
    ).confidence_interval
    return Interval(float(found.low), float(found.high))
