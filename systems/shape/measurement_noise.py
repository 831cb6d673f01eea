"""Noise of measured cross-sections, and their likelihood given their distances from a path."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle_shape import path_statistics
from sonoservo.systems.signals.requirements import require, require_positive

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class MeasurementNoise:
    """Noise of measured cross-sections, with a level that is learned from their scatter.

    The variance has an inverse gamma distribution. Integration over it leaves a likelihood that
    depends on the sum of squares only. Scattered slices therefore widen the uncertainty.

    Parameters
    ----------
    std
        Expected standard deviation of x and of y, in m.
    confidence
        Number of measurements to which the expectation is equivalent.
    independence
        Share of a slice's information that its neighbours do not already contain. It is below 1 if
        errors are correlated from slice to slice, as they are through the speckle of overlapping
        slices.
    outlier
        Distance of a measurement from its prediction, in standard deviations, beyond which its
        weight falls in inverse proportion (Huber).
    """

    std: float = 0.12e-3
    confidence: float = 10.0
    independence: float = 0.9
    outlier: float = 3.0

    def __post_init__(self) -> None:
        require_positive(std=self.std, confidence=self.confidence, outlier=self.outlier)
        allowed = "above 0 and at most 1"
        require(0 < self.independence <= 1, "independence", self.independence, allowed)

    def log_likelihood(self, squares: Floats, total: float) -> Floats:
        """Return (n,) logarithms of the likelihood of squared residuals, up to a constant.

        ``squares`` are the (n,) weighted sums in m^2 about each path's best origin, ``total`` that
        of the weights of the cross-sections, each of which measures x and y.
        """
        degrees = self.confidence + max(2 * total - 2, 0.0)
        return -0.5 * degrees * np.log(self._scale + squares)

    def variance(self, squares: float, total: float) -> float:
        """Return the learned variance of x and of y, in m^2; see `log_likelihood`."""
        return (self._scale + squares) / (self.confidence + max(2 * total - 2, 0.0))

    def weight(
        self, point: Floats, paths: Floats, weights: Floats, origin_variance: float, variance: float
    ) -> float:
        """Return the weight of a measured (2,) x and y in I, in m; an unexpected one has less.

        ``paths`` are the (n, 2) x and y there before the measurement, ``weights`` theirs; the
        variances are those of x and of y, of each path's origin and of a measurement, in m^2.
        """
        mean, covariance = path_statistics(paths[:, np.newaxis], weights)
        innovation = point - mean[0]
        spread = covariance[0] + (origin_variance + variance) * np.eye(2)
        distance = float(np.sqrt(innovation @ np.linalg.solve(spread, innovation)))
        return self.independence * min(1.0, self.outlier / max(distance, 1e-9))

    @property
    def _scale(self) -> float:
        return self.confidence * self.std**2
