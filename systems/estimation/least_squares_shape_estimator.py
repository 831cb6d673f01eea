"""Leaf: the shape of a needle by Bayesian least squares."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.estimation.shape_least_squares import (
    FittedShape,
    ShapeFit,
    ShapeLeastSquaresParameters,
)
from sonoservo.systems.signals.needle_shape import bicycle_paths, path_statistics

Floats = NDArray[np.float64]


class LeastSquaresShapeEstimator(ShapeEstimator):
    """A `ShapeEstimator` by the fit of `shape_least_squares`.

    Parameters
    ----------
    parameters
        Of the fit.
    events
        X_WI, period, offset and seed: see `ShapeEstimator`.
    """

    def __init__(
        self,
        *,
        parameters: ShapeLeastSquaresParameters,
        **events: Any,
    ) -> None:
        self._parameters = parameters
        self._fit = ShapeFit(parameters)
        super().__init__(parameters=parameters, **events)
        self.set_name("least_squares_shape_estimator")

    def _begin(self, rng: np.random.Generator) -> FittedShape:
        return self._fit.begin()

    def _updated(self, belief: FittedShape, p_I: Floats, rng: np.random.Generator) -> FittedShape:
        weight = self._parameters.noise.independence
        if len(belief.points):
            paths = self._represented(belief, rng)
            across = bicycle_paths(paths["parameters"], p_I[2:], self._parameters.rotations)
            mean, covariance = path_statistics(paths["origins"][:, np.newaxis] + across,
                                               paths["weights"])  # fmt: skip
            spread = covariance[0] + self._fit.variance(belief) * np.eye(2)
            weight = self._parameters.noise.weight(p_I[:2] - mean[0], spread)
        return self._fit.update(belief, p_I, weight)

    def _represented(self, belief: FittedShape, rng: np.random.Generator) -> dict[str, Any]:
        parameters, origins = self._fit.sample(belief, rng)
        count = len(parameters)
        return {
            "parameters": parameters,
            "origins": origins,
            "weights": np.full(count, 1 / count),
            "origin_variance": 0.0,
        }
