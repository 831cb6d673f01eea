"""Leaf: the shape of a needle by a particle filter with a joint likelihood."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.estimation.shape_particle_filter import (
    ParticleBelief,
    ShapeParticleFilterParameters,
    ShapePosterior,
    begin,
    update,
)
from sonoservo.systems.estimation.shape_posterior import about_best_origin
from sonoservo.systems.signals.needle_shape import bicycle_paths, path_statistics

Floats = NDArray[np.float64]


class ParticleShapeEstimator(ShapeEstimator):
    """A `ShapeEstimator` by the particle filter of `shape_particle_filter`.

    Parameters
    ----------
    parameters
        Of the filter.
    events
        X_WI, period, offset and seed: see `ShapeEstimator`.
    """

    def __init__(
        self,
        *,
        parameters: ShapeParticleFilterParameters,
        **events: Any,
    ) -> None:
        self._parameters = parameters
        self._posterior = ShapePosterior(parameters)
        super().__init__(parameters=parameters, **events)
        self.set_name("particle_shape_estimator")

    def _begin(self, rng: np.random.Generator) -> ParticleBelief:
        return begin(self._posterior, rng)

    def _updated(
        self, belief: ParticleBelief, p_I: Floats, rng: np.random.Generator
    ) -> ParticleBelief:
        noise = self._parameters.noise
        weight = self._parameters.noise.independence
        if len(belief.points):
            paths = self._represented(belief, rng)
            across = bicycle_paths(paths["parameters"], p_I[2:], self._parameters.rotations)
            mean, covariance = path_statistics(paths["origins"][:, np.newaxis] + across,
                                               paths["weights"])  # fmt: skip
            spread = paths["origin_variance"] + self._variance(belief)
            weight = noise.weight(p_I[:2] - mean[0], covariance[0] + spread * np.eye(2))
        return update(belief, p_I, weight, self._posterior, self._parameters.moves, rng)

    def _variance(self, belief: ParticleBelief) -> float:
        """Learned variance of a measurement, in m^2."""
        squares = about_best_origin(belief.sums, belief.total)
        share = belief.normalized_weights
        usable = share > 0
        return self._parameters.noise.variance(float(share[usable] @ squares[usable]), belief.total)

    def _represented(self, belief: ParticleBelief, rng: np.random.Generator) -> dict[str, Any]:
        return {
            "parameters": belief.particles,
            "origins": belief.sums[:, :2] / belief.total,
            "weights": belief.normalized_weights,
            "origin_variance": self._variance(belief) / belief.total,
        }
