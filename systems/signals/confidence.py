"""Quantiles of normal distributions in space and in a plane."""

import numpy as np
from scipy.special import gammaincinv


def squared_distance(probability: float, freedom: int) -> float:
    """Return the squared Mahalanobis distance that contains a share of a normal distribution.

    It is the quantile of chi-squared with as many degrees of freedom as there are dimensions; the
    module `scipy.stats` would take a third of a second to load.
    """
    return 2.0 * float(gammaincinv(0.5 * freedom, probability))


SQUARED_DISTANCE_95 = squared_distance(0.95, 2)
"""Squared Mahalanobis distance that contains 95 % of a normal distribution in a plane."""

RADIUS_95 = float(np.sqrt(SQUARED_DISTANCE_95))
"""Number of standard deviations that contains 95 % of a normal distribution in a plane."""
