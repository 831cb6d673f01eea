"""Interface of the shape filters, which update a belief about a needle's shape."""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.shape.shape_parameters import ShapeEstimatorParameters
from sonoservo.systems.signals.immutable import NotFound

Floats = NDArray[np.float64]


class ShapePaths(NamedTuple):
    """Weighted paths of the bicycle model; see the fields of `NeedleShape` with the same names."""

    parameters: Floats
    origins: Floats
    weights: Floats
    origin_variance: float = 0.0
    wander: Floats = np.zeros((0, 0, 2))
    wander_length: float = 0.02


class ShapeFilter(Protocol):
    """Filter for the shape of a needle; its beliefs are immutable values of its own type."""

    @property
    def parameters(self) -> ShapeEstimatorParameters:
        """Parameters common to all filters: depth, rotations, prior."""

    def begin(self, rng: np.random.Generator) -> Any:
        """Return the belief before any measurement."""

    def update(self, belief: Any, point: Floats, rng: np.random.Generator) -> Any:
        """Return the belief after one more measurement, (3,) x, y and depth in I, in m."""

    def represent(self, belief: Any, rng: np.random.Generator) -> ShapePaths | NotFound:
        """Return paths that represent the belief, or the reason why there are none yet."""
