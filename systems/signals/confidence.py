"""Quantiles of normal distributions in a plane."""

import numpy as np
from scipy.stats import chi2

SQUARED_DISTANCE_95 = float(chi2.ppf(0.95, 2))
"""Squared Mahalanobis distance within which 95 % of a normal distribution in a plane lie."""

RADIUS_95 = float(np.sqrt(SQUARED_DISTANCE_95))
"""Number of standard deviations within which 95 % of a normal distribution in a plane lie."""
