"""Leaf: the shape of a needle by the particle filter of Carriere 2016, as printed."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.published_particle_filter import (
    PublishedBelief,
    PublishedParticleFilterParameters,
    begin,
    represent,
    update,
)
from sonoservo.systems.estimation.shape_estimator import ShapeEstimator
from sonoservo.systems.signals.immutable import NotFound

Floats = NDArray[np.float64]


class PublishedShapeEstimator(ShapeEstimator):
    """A `ShapeEstimator` by the filter of `published_particle_filter`.

    Its uncertainty is the spread of the particles, as the paper has it, which says little about
    the error.

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
        parameters: PublishedParticleFilterParameters,
        **events: Any,
    ) -> None:
        self._parameters = parameters
        super().__init__(parameters=parameters, **events)
        self.set_name("published_shape_estimator")

    def _begin(self, rng: np.random.Generator) -> PublishedBelief:
        return begin(self._parameters, rng)

    def _updated(
        self, belief: PublishedBelief, p_I: Floats, rng: np.random.Generator
    ) -> PublishedBelief:
        return update(belief, p_I, self._parameters, rng)

    def _represented(
        self, belief: PublishedBelief, rng: np.random.Generator
    ) -> dict[str, Any] | NotFound:
        if belief.plane is None:
            return NotFound(
                f"the filter starts {1e3 * self._parameters.start_depth:g} mm deep, "
                f"with {self._parameters.points} points"
            )
        parameters, origins = represent(belief)
        return {
            "parameters": parameters,
            "origins": origins,
            "weights": np.full(4, 0.25),
            "origin_variance": 0.0,
        }
