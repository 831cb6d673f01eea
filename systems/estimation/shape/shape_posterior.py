"""Likelihood of measured cross-sections given paths of the bicycle model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape.shape_filter import ShapePaths
from sonoservo.systems.signals.needle_shape import bicycle_paths, path_statistics
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
        slices; 0.6 suits slices every 0.5 mm with a beam 1 mm thick.
    outlier
        Distance of a measurement from its prediction, in standard deviations, beyond which its
        weight falls in inverse proportion (Huber).
    """

    std: float = 0.12e-3
    confidence: float = 10.0
    independence: float = 0.6
    outlier: float = 3.0

    def __post_init__(self) -> None:
        require_positive(std=self.std, confidence=self.confidence, outlier=self.outlier)
        allowed = "above 0 and at most 1"
        require(0 < self.independence <= 1, "independence", self.independence, allowed)

    def log_likelihood(self, squares: Floats, total: float) -> Floats:
        """Return the logarithm of the likelihood, up to a constant.

        Parameters
        ----------
        squares
            (n,) weighted sum of squared residuals about the best origin of each path, in m^2.
        total
            Sum of the weights of the cross-sections, each of which measures x and y.
        """
        degrees = self.confidence + max(2 * total - 2, 0.0)
        return -0.5 * degrees * np.log(self._scale + squares)

    def variance(self, squares: float, total: float) -> float:
        """Return the learned variance of x and of y, in m^2; see `log_likelihood`."""
        return (self._scale + squares) / (self.confidence + max(2 * total - 2, 0.0))

    def weight(
        self, point: Floats, predicted: ShapePaths, rotations: Sequence[float], variance: float
    ) -> float:
        """Return the weight of a measurement, which is smaller for an unexpected one.

        Parameters
        ----------
        point
            (3,) measured x, y and depth in I, in m.
        predicted
            Paths before the measurement.
        rotations
            Depths at which the bevel is turned, in m.
        variance
            Variance of x and of y of a measurement, in m^2.
        """
        across = bicycle_paths(predicted.parameters, point[2:], rotations)
        paths = predicted.origins[:, np.newaxis] + across
        mean, covariance = path_statistics(paths, predicted.weights)
        innovation = point[:2] - mean[0]
        spread = covariance[0] + (predicted.origin_variance + variance) * np.eye(2)
        distance = float(np.sqrt(innovation @ np.linalg.solve(spread, innovation)))
        return self.independence * min(1.0, self.outlier / max(distance, 1e-9))

    @property
    def _scale(self) -> float:
        return self.confidence * self.std**2


@njit(cache=True, error_model="numpy", nogil=True)
def residual_sums(u, plane, points, weights):  # type: ignore[no-untyped-def]
    """Return weighted sums of residuals and of their squares.

    Parameters
    ----------
    u
        (n, m) deflections of n paths at the depths of m measurements, in m.
    plane
        (n,) angles phi of the paths' planes, in rad.
    points, weights
        (m, 2) measured x and y, in m, and (m,) their weights.

    Returns
    -------
    (n, 3) weighted sums of the residuals in x and in y, in m, and of their squares, in m^2.
    """
    sums = np.zeros((len(u), 3))
    for i in range(len(u)):
        cosine, sine = np.cos(plane[i]), np.sin(plane[i])
        for j in range(len(points)):
            x = points[j, 0] - cosine * u[i, j]
            y = points[j, 1] - sine * u[i, j]
            sums[i, 0] += weights[j] * x
            sums[i, 1] += weights[j] * y
            sums[i, 2] += weights[j] * (x * x + y * y)
    return sums


def about_best_origin(sums: Floats, total: float) -> Floats:
    """Return the (n,) sums of squares in m^2 about the most probable origin of each path."""
    squares = sums[:, 2] - (sums[:, 0] ** 2 + sums[:, 1] ** 2) / total
    return np.where(np.isfinite(squares), np.maximum(squares, 0.0), np.inf)
