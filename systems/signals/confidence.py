"""Quantiles of normal distributions in space and in a plane."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

from sonoservo.systems.signals.requirements import require


def squared_distance(probability: float, freedom: int) -> float:
    """Return the squared Mahalanobis distance that contains a share of a normal distribution.

    It is the quantile of chi-squared with as many degrees of freedom as there are dimensions; the
    module `scipy.stats` would take a third of a second to load.
    """
    return 2.0 * float(gammaincinv(0.5 * freedom, probability))


def confidence_ellipsoid(
    covariance: ArrayLike, probability: float = 0.95
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (3, 3) rotation to an ellipsoid of confidence, and its half axes in m."""
    require(0 < probability < 1, "probability", probability, "between 0 and 1")
    variances, axes = np.linalg.eigh(np.asarray(covariance, dtype=float))
    if np.linalg.det(axes) < 0:
        axes = axes * [1, 1, -1]
    return axes, np.sqrt(np.maximum(variances, 0) * squared_distance(probability, 3))


SQUARED_DISTANCE_95 = squared_distance(0.95, 2)
"""Squared Mahalanobis distance that contains 95 % of a normal distribution in a plane."""

RADIUS_95 = float(np.sqrt(SQUARED_DISTANCE_95))
"""Number of standard deviations that contains 95 % of a normal distribution in a plane."""
