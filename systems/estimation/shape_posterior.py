"""How well paths of the bicycle model explain measured cross-sections."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import require, require_positive

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class MeasurementNoise:
    """The noise of measured cross-sections, whose level is learned from their scatter.

    Its variance has an inverse gamma distribution; integrating over it leaves a likelihood that
    depends on the sum of squares only, so that scattered slices widen the uncertainty themselves.

    Parameters
    ----------
    std
        Expected standard deviation of x and of y, in m.
    confidence
        Number of measurements that the expectation counts for.
    independence
        Share of what a slice tells that its neighbours have not told: below 1 where errors are
        correlated from slice to slice, as speckle makes them where slices overlap: 0.6 fits slices
        every 0.5 mm with a beam 1 mm thick.
    outlier
        A measurement further from its prediction than this many standard deviations counts less,
        in inverse proportion (Huber).
    """

    std: float = 0.12e-3
    confidence: float = 10.0
    independence: float = 0.6
    outlier: float = 3.0

    def __post_init__(self) -> None:
        require_positive(std=self.std, confidence=self.confidence, outlier=self.outlier)
        require(0 < self.independence <= 1, "independence", self.independence, "above 0, at most 1")

    def log_likelihood(self, squares: Floats, total: float) -> Floats:
        """Logarithm of the likelihood, up to a constant.

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
        """Learned variance of x and of y, in m^2; see `log_likelihood`."""
        return (self._scale + squares) / (self.confidence + max(2 * total - 2, 0.0))

    def weight(self, innovation: Floats, covariance: Floats) -> float:
        """Weight of a measurement, (2,) away from its prediction, (2, 2) covariance of that."""
        distance = float(np.sqrt(innovation @ np.linalg.solve(covariance, innovation)))
        return self.independence * min(1.0, self.outlier / max(distance, 1e-9))

    @property
    def _scale(self) -> float:
        return self.confidence * self.std**2


@njit(cache=True, error_model="numpy", nogil=True)
def residual_sums(u, plane, points, weights):  # type: ignore[no-untyped-def]
    """Weighted sums of residuals and of their squares.

    Parameters
    ----------
    u
        (n, m) deflections of n paths at the depths of m measurements, in m.
    plane
        (n,) of each path, in rad.
    points, weights
        (m, 2) measured x and y, in m, and (m,).

    Returns
    -------
    (n, 3) sums of x, of y in m, and of their squares in m^2.
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
    """(n,) squares in m^2 that are left when each path's origin is at its best place."""
    squares = sums[:, 2] - (sums[:, 0] ** 2 + sums[:, 1] ** 2) / total
    return np.where(np.isfinite(squares), np.maximum(squares, 0.0), np.inf)
