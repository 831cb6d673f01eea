"""Quantiles of normal distributions in a plane."""

import numpy as np
from scipy.stats import chi2

SQUARED_DISTANCE_95 = float(chi2.ppf(0.95, 2))
"""Squared Mahalanobis distance that contains 95 % of a normal distribution in a plane."""

RADIUS_95 = float(np.sqrt(SQUARED_DISTANCE_95))
"""Number of standard deviations that contains 95 % of a normal distribution in a plane."""
