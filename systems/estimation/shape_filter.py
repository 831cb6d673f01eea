"""Interface of the shape filters: a belief about a needle's shape that takes measurements."""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.estimation.shape_parameters import ShapeEstimatorParameters
from sonoservo.systems.signals.immutable import NotFound

Floats = NDArray[np.float64]


class ShapePaths(NamedTuple):
    """Weighted paths of the bicycle model; see the fields of `NeedleShape` with the same names."""

    parameters: Floats
    origins: Floats
    weights: Floats
    origin_variance: float = 0.0


class ShapeFilter(Protocol):
    """A filter for the shape of a needle; its beliefs are immutable values of its own."""

    @property
    def parameters(self) -> ShapeEstimatorParameters:
        """Parameters that every filter has: depth, rotations, prior."""

    def begin(self, rng: np.random.Generator) -> Any:
        """Return the belief before any measurement."""

    def update(self, belief: Any, point: Floats, rng: np.random.Generator) -> Any:
        """Return the belief after one more measurement, (3,) x, y and depth in I, in m."""

    def represent(self, belief: Any, rng: np.random.Generator) -> ShapePaths | NotFound:
        """Return paths that stand for the belief, or a reason why there are none yet."""
